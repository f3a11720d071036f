"""Break down a run's error by image region, corruption family and severity.

A mean error can grow because every pixel is slightly worse or because a few pixels fail completely. Fl, the share of
outlier pixels (error above 3 px and 5 %), distinguishes the two cases. Rows contain counts, not individual pixels, so a
change in Fl is net: new outliers minus pixels that are no longer outliers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl

from ..corruptions.names import MEMBERS
from ..metrics.summary import Summary

REGION_LABELS = {
    "noc": "not occluded",
    "occ": "occluded",
    "s0_10": "motion below 10 px",
    "s10_40": "motion 10 to 40 px",
    "s40": "motion above 40 px",
    "d0_10": "within 10 px of a motion edge",
    "d10_60": "10 to 60 px from a motion edge",
    "d60": "more than 60 px from a motion edge",
}


def by_region(summary: Summary) -> pl.DataFrame:
    """Compute the errors in each image region.

    Returns:
        A table with the columns region, label, share (percent of the valid pixels), epe_clean, epe, cre, crer, rcre,
        fl_clean, fl, and broken (net percent of the region's pixels that became Fl outliers), in the order of
        `metrics.regions.REGIONS`.
    """
    records = [
        (
            *(name, REGION_LABELS[name], scores.share, scores.epe_clean, scores.epe, scores.cre, scores.crer),
            *(scores.rcre, scores.fl_clean, scores.fl, _minus(scores.fl, scores.fl_clean)),
        )
        for name, scores in summary.regions.items()
    ]
    numbers = ("share", "epe_clean", "epe", "cre", "crer", "rcre", "fl_clean", "fl", "broken")
    return _frame(records, ("region", "label"), numbers)


def by_family(summary: Summary) -> pl.DataFrame:
    """Compute the errors under each corruption family.

    Returns:
        A table with the columns family, corruptions (number of corruptions run), epe, cre, crer, rcre, fl, broken (net
        percent of pixels), and contribution (of the family to the overall CRE, in pixels; negative if it reduces the
        error). If only the paper's corruptions were run, the contributions add up to the CRE. Percentages would be
        misleading: if one family has a negative contribution, the others add up to more than 100 %.
    """
    averaged = summary.averaged_over
    records = []
    for family, scores in summary.families.items():
        count = sum(name in averaged for name in MEMBERS[family])
        part = None
        if scores.cre is not None:
            part = scores.cre * count / len(averaged)
        broken = _minus(scores.fl, summary.clean.fl)
        records.append((family, count, scores.epe, scores.cre, scores.crer, scores.rcre, scores.fl, broken, part))
    numbers = ("corruptions", "epe", "cre", "crer", "rcre", "fl", "broken", "contribution")
    return _frame(records, ("family",), numbers)


def severity_slopes(summary: Summary, metric: str) -> dict[str, float]:
    """Fit how a metric grows with severity: corruption -> least-squares slope, in the metric's unit per severity level.
    Corruptions with fewer than two severities are left out."""
    slopes = {}
    for name, scores in summary.corruptions.items():
        pairs = zip(scores.severities, scores.by_severity[metric], strict=True)
        known = [(level, value) for level, value in pairs if value is not None]
        if len(known) > 1:
            levels, values = np.array(known, np.float64).T
            slopes[name] = float(np.polyfit(levels, values, 1)[0])
    return slopes


def _minus(after: float | None, before: float | None) -> float | None:
    return None if after is None or before is None else after - before


def _frame(records: list[tuple[Any, ...]], texts: tuple[str, ...], numbers: tuple[str, ...]) -> pl.DataFrame:
    schema = dict.fromkeys(texts, pl.String) | dict.fromkeys(numbers, pl.Float64)
    return pl.DataFrame(records, schema=schema, orient="row", strict=False)

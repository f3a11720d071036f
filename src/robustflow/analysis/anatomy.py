"""Anatomy of a run's error: where in the image, by which family, how fast with severity.

A mean error can grow because every pixel is a little worse, or because a few break. Fl tells the two apart: the share
of pixels that are wrong (error above 3 px and 5 %). Rows hold counts rather than pixels, so a change of the share is
net: broken minus healed.
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
    """Errors inside each region.

    Returns:
        Columns region, label, share (percent of the valid pixels), epe_clean, epe, cre, crer, rcre, fl_clean, fl, and
        broken (percent of the region's pixels that became Fl outliers, net); in the order of `metrics.regions.REGIONS`.
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
    """Errors under each family of corruptions.

    Returns:
        Columns family, corruptions (how many were run), epe, cre, crer, rcre, fl, broken (percent of pixels, net), and
        contribution (pixels of the overall CRE that this family adds; below 0 if it helps). If only the paper's
        corruptions were run, the contributions add up to the CRE. Shares of it would be meaningless: if one family
        helps, those of the others exceed 100 %.
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


def by_severity(summary: Summary, metric: str = "epe") -> pl.DataFrame:
    """How a metric grows with severity, per corruption.

    Returns:
        Columns corruption, family, slope (metric's unit per step of severity, least squares), lowest, highest, bend
        (slope of the upper half of the severities minus that of the lower: above 0, the growth accelerates), rises
        (whether no step lowers it). Corruptions with fewer than two severities are left out; bend needs four.
    """
    records = []
    for name, scores in summary.corruptions.items():
        pairs = [
            (level, value)
            for level, value in zip(scores.severities, scores.by_severity[metric], strict=True)
            if value is not None
        ]
        if len(pairs) < 2:
            continue
        levels, values = (np.array(column, np.float64) for column in zip(*pairs, strict=True))
        half = (len(levels) + 1) // 2
        bend = None
        if len(levels) >= 4:
            bend = _slope(levels[-half:], values[-half:]) - _slope(levels[:half], values[:half])
        rises = bool((np.diff(values) >= 0).all())
        records.append(
            (name, scores.family, _slope(levels, values), float(values.min()), float(values.max()), bend, rises)
        )
    frame = _frame([record[:6] for record in records], ("corruption", "family"), ("slope", "lowest", "highest", "bend"))
    return frame.with_columns(rises=pl.Series([record[6] for record in records], dtype=pl.Boolean))


def _slope(levels: Any, values: Any) -> float:
    return float(np.polyfit(levels, values, 1)[0])


def _minus(after: float | None, before: float | None) -> float | None:
    return None if after is None or before is None else after - before


def _frame(records: list[tuple[Any, ...]], texts: tuple[str, ...], numbers: tuple[str, ...]) -> pl.DataFrame:
    schema = dict.fromkeys(texts, pl.String) | dict.fromkeys(numbers, pl.Float64)
    return pl.DataFrame(records, schema=schema, orient="row", strict=False)

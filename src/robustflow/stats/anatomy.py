"""Break down a run's error by image region, corruption family and severity; collect the flow histograms of runs.

A mean error can grow because every pixel is slightly worse or because a few pixels fail completely. Fl, the share of
outlier pixels (error above 3 px and 5 %), distinguishes the two cases. Rows contain counts, not individual pixels, so a
change in Fl is net: new outliers minus pixels that are no longer outliers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import polars as pl

from ..core.text import counted, plain
from ..corruptions.registry import MEMBERS
from ..metrics.rows import CLEAN
from ..run.comparable import sample_set
from ..run.costs import GROUND_TRUTH, DisplacementFile, read_displacement
from ..run.run import Run
from ..run.summary import Averages
from .results import benchmark_label

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


class ErrorPart(NamedTuple):
    """The error of a run in one image region or under one corruption family; values that were not measured are None."""

    label: str
    share: float | None
    contribution: float | None
    cre: float | None
    crer: float | None
    rcre: float | None
    broken: float | None


def error_parts(run: Averages) -> list[ErrorPart]:
    """Return the parts of the error: image regions in the order of `metrics.regions.REGIONS`, then families."""
    whole = run.measured.complete and not run.has_gaps
    averaged = run.measured.averaged_over

    def part(label: str, of: str, clean_fl: float | None, adds: float | None = None) -> ErrorPart:
        fl = run.mean("fl", of)
        broken = fl - clean_fl if whole and fl is not None and clean_fl is not None else None
        cre, crer, rcre = (run.mean(metric, of) for metric in ("cre", "crer", "rcre"))
        return ErrorPart(label, run.mean("share", of), adds, cre, crer, rcre, broken)

    conditions = {condition for _, condition, _ in run.means}
    parts = [
        part(REGION_LABELS[name], name, run.mean("fl_clean", name)) for name in REGION_LABELS if name in conditions
    ]
    for family, members in MEMBERS.items():
        if family in conditions:
            cre = run.mean("cre", family)
            adds = None if cre is None else cre * sum(name in averaged for name in members) / len(averaged)
            parts.append(part(f"{family} corruptions", family, run.mean("fl", CLEAN), adds))
    return parts


def severity_slopes(run: Averages, metric: str) -> dict[str, float]:
    """Fit how a metric grows with severity: corruption -> least-squares slope, in the metric's unit per severity level.
    Corruptions with fewer than two severities are left out."""
    slopes = {}
    for name, levels in run.measured.corruptions.items():
        known = [(level, value) for level in levels if (value := run.mean(metric, name, level)) is not None]
        if len(known) > 1:
            x, y = np.array(known, np.float64).T
            slopes[name] = float(np.polyfit(x, y, 1)[0])
    return slopes


def displacements_of(runs: Sequence[Run]) -> dict[str, pl.DataFrame]:
    """Return the figure's histograms by label, one per sample set, computed from the ground truth if a run has it."""
    by_samples: dict[str, tuple[str, DisplacementFile]] = {}
    for run in runs:
        one, frames = read_displacement(run), sample_set(run)
        if one is None or not any(one.pixels):
            continue
        if frames not in by_samples or one.source == GROUND_TRUTH != by_samples[frames][1].source:
            by_samples[frames] = run.benchmark, one
    return {label: one.table for label, one in _labelled(by_samples.values())}


def label_of(benchmark: str, samples: int, source: str) -> str:
    """Return the label of a histogram in the figure.

    >>> label_of("kitti-fc", 80, "ground truth")
    'KITTI-FC, 80 pairs (ground truth)'
    """
    return f"{benchmark_label(benchmark)}, {counted(samples, 'pair')} ({plain(source, 40)})"


def _labelled(kept: Iterable[tuple[str, DisplacementFile]]) -> Iterator[tuple[str, DisplacementFile]]:
    """Keep one histogram for sample sets that differ only in corruptions or seed; number different histograms with the
    same label."""
    seen: dict[str, list[DisplacementFile]] = {}
    for benchmark, one in kept:
        label = label_of(benchmark, one.samples, one.source)
        alike = seen.setdefault(label, [])
        if any((other.low, other.pixels) == (one.low, one.pixels) for other in alike):
            continue
        alike.append(one)
        yield (label if len(alike) == 1 else f"{label} #{len(alike)}"), one

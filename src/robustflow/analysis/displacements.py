"""Collect the flow-magnitude histograms stored with runs, one per sample set, and label them for a figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import polars as pl

from ..runs.comparable import sample_set
from ..runs.displacement_file import GROUND_TRUTH, DisplacementFile, read_displacement
from ..runs.run import Run
from ..text import counted, plain
from .labels import benchmark_label


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

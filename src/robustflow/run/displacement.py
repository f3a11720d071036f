"""Compute the histogram of flow magnitudes of a benchmark (the paper's figure "Optical flow amplitude statistic"), from
ground truth or from a model's flow on the clean frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import polars as pl
from pydantic import Field, model_validator

from ..core.errors import DataError, ModelError, RunError, UsageError
from ..core.text import counted, plain
from ..core.types import Flow, Mask
from ..data.benchmarks import Benchmark, benchmark_facts
from ..metrics.rows import CLEAN
from ..models.calls import describe_cell, predict_checked
from ..models.protocols import AnyModel, FlowLookup, FlowModel
from .comparable import sample_set
from .costs import RunAttachment
from .run import Run
from .stages import frames_digest

EDGES: tuple[float, ...] = (*(float(edge) for edge in range(0, 101, 2)), float("inf"))
"""Bin edges of flow magnitudes in pixels; the last bin contains all magnitudes of at least 100."""
GROUND_TRUTH = "ground truth"
"""Value of `source` for a histogram of the ground truth."""
_MOST_BINS = 10_000


def displacement_histogram(
    benchmark: Benchmark,
    model: AnyModel | None = None,
    source: str = "",
    progress: Callable[[int], None] = lambda done: None,
    digests: Mapping[str, str] | None = None,
) -> pl.DataFrame:
    """Count pixels by flow magnitude over all samples of a benchmark, with one sample in memory at a time."""
    if model is None and not benchmark.dataset.has_flow:
        raise DataError(benchmark.name, "has no ground truth; name the model whose flow should be measured")
    if model is not None and not isinstance(model, FlowModel | FlowLookup):
        raise UsageError("--model", "displacement is measured on the flow of pairs; choose a two-frame model")
    table = histogram(_flows(benchmark, model, progress, digests or {}))
    name = GROUND_TRUTH if model is None else source or type(model).__name__
    return table.select(pl.lit(benchmark.name).alias("benchmark"), pl.lit(name).alias("source"), pl.all())


def histogram(flows: Iterable[tuple[Flow, Mask]]) -> pl.DataFrame:
    """Return the columns `low`, `high`, `pixels` and `share` for flows with valid masks."""
    counts = np.zeros(len(EDGES) - 1, np.int64)
    valid_pixels = 0
    for flow, valid in flows:
        amplitude = np.hypot(flow[..., 0], flow[..., 1], dtype=np.float64)[valid]
        amplitude = amplitude[np.isfinite(amplitude)]
        counts += np.histogram(amplitude, np.minimum(EDGES, np.finfo(np.float64).max))[0]
        valid_pixels += amplitude.size
    low, high = np.asarray(EDGES[:-1], np.float64), np.asarray(EDGES[1:], np.float64)
    return pl.DataFrame({"low": low, "high": high, "pixels": counts, "share": counts / max(1, valid_pixels)})


class DisplacementFile(RunAttachment):
    """The histogram of a run's displacements."""

    FILE = "displacement.json"
    COMMAND = "reproduce displacement"

    samples: Annotated[int, Field(ge=1)]
    source: Annotated[str, Field(min_length=1, max_length=500)]
    low: Annotated[list[Annotated[float, Field(ge=0, le=1e9)]], Field(min_length=1, max_length=_MOST_BINS)]
    pixels: Annotated[list[Annotated[int, Field(ge=0, le=10**18)]], Field(min_length=1, max_length=_MOST_BINS)]

    @model_validator(mode="after")
    def _bins_fit(self) -> DisplacementFile:
        if len(self.low) != len(self.pixels) or self.low[0] != 0 or sorted(set(self.low)) != self.low:
            raise ValueError("edges must ascend from 0, with one edge per count")
        return self

    @property
    def table(self) -> pl.DataFrame:
        """Return the columns `low`, `high` (pixels, the last infinite) and `share` (of all counted pixels)."""
        total = max(1, sum(self.pixels))
        share = [count / total for count in self.pixels]
        return pl.DataFrame({"low": self.low, "high": [*self.low[1:], math.inf], "share": share})


def read_displacement(run: Run) -> DisplacementFile | None:
    """Return the histogram of a run; None if there is none, or if the run now has different samples."""
    displacement = DisplacementFile.read(run)
    return displacement if displacement and displacement.samples == len(run.manifest.samples) else None


def write_displacement(run: Run, table: pl.DataFrame) -> Path:
    """Store the table of `displacement_histogram` for a run's samples in the run's folder."""
    content = DisplacementFile(
        run=run.manifest.identity_digest,
        samples=len(run.manifest.samples),
        source=table["source"][0],
        low=table["low"].to_list(),
        pixels=table["pixels"].to_list(),
    )
    return content.write(run.path)


def keep_displacement(result: Run, benchmark: Benchmark) -> None:
    """Store the histogram of a run's ground truth for its pages, unless it exists or there is no ground truth."""
    if not benchmark.dataset.has_flow:
        return
    try:
        stored = read_displacement(result)
    except RunError:
        stored = None  # damaged, so the histogram is computed again
    if stored is None:
        samples = replace(benchmark, keys=tuple(result.manifest.samples))
        write_displacement(result, displacement_histogram(samples))


def clean_digests(run: Run) -> dict[str, str]:
    """Map every sample that a run has measured to the digest of its clean frames."""
    return dict(run.rows.filter(corruption=CLEAN).select("sample", "frames_digest").iter_rows())


def displacements_of(runs: Iterable[Run]) -> dict[str, pl.DataFrame]:
    """Return the figure's histograms by label, one per sample set, computed from the ground truth if a run has it.

    Sample sets with the same label share a histogram if it is equal; different histograms are numbered."""
    by_samples: dict[str, tuple[str, DisplacementFile]] = {}
    for run in runs:
        stored, frames = read_displacement(run), sample_set(run)
        if stored is None or not any(stored.pixels):
            continue
        if frames not in by_samples or stored.source == GROUND_TRUTH != by_samples[frames][1].source:
            by_samples[frames] = displacement_label(run.benchmark, stored.samples, stored.source), stored
    by_label: dict[str, list[DisplacementFile]] = {}
    for label, stored in by_samples.values():
        different = by_label.setdefault(label, [])
        if all((other.low, other.pixels) != (stored.low, stored.pixels) for other in different):
            different.append(stored)
    return {
        label if number == 1 else f"{label} #{number}": stored.table
        for label, different in by_label.items()
        for number, stored in enumerate(different, start=1)
    }


def displacement_label(benchmark: str, samples: int, source: str) -> str:
    """Return the label of a histogram in the figure.

    >>> displacement_label("kitti-fc", 80, "ground truth")
    'KITTI-FC, 80 pairs (ground truth)'
    """
    return f"{plain(benchmark_facts(benchmark).title, 40)}, {counted(samples, 'pair')} ({plain(source, 40)})"


def _flows(
    benchmark: Benchmark,
    model: FlowModel | FlowLookup | None,
    progress: Callable[[int], None],
    digests: Mapping[str, str],
) -> Iterator[tuple[Flow, Mask]]:
    for number, key in enumerate(benchmark.keys, start=1):
        sample = benchmark.dataset.load(key)
        if key in digests and frames_digest(sample.frames[:2]) != digests[key]:
            raise RunError(
                f"{benchmark.name}, sample '{key}'", "these are not the frames of the run; use the --data of the run"
            )
        if model is None:
            if sample.flow is None or sample.valid is None:
                raise DataError(f"{benchmark.name}, sample '{key}'", "no ground truth; name a model instead")
            yield sample.flow, sample.valid
        else:
            flow = predict_checked(model, sample.frames, key, "clean", 0)
            if broken := int((~np.isfinite(flow).all(axis=-1)).sum()):
                where = describe_cell(key, "clean", 0)
                raise ModelError(where, f"NaN or infinite at {counted(broken, 'pixel')}; fix the model")
            yield flow, np.ones(sample.shape, np.bool_)
        progress(number)

"""Compute the histogram of flow magnitudes of a benchmark (the paper's figure "Optical flow amplitude statistic"), from
ground truth or from a model's flow on the clean frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import polars as pl

from ..core.errors import DataError, ModelError, RunError, UsageError
from ..core.text import counted
from ..core.types import Flow, Mask
from ..data.benchmarks import Benchmark
from ..models.base import AnyModel, FlowLookup, FlowModel, describe_cell, predict_checked
from .costs import GROUND_TRUTH, read_displacement, write_displacement
from .run import Run
from .stages import frames_digest

EDGES: tuple[float, ...] = (*(float(edge) for edge in range(0, 101, 2)), float("inf"))
"""Bin edges of flow magnitudes in pixels; the last bin contains all magnitudes of at least 100."""


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

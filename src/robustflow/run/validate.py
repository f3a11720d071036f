"""Measure a loaded model under corruptions and keep the rows in memory, as a training loop needs it: without a folder,
a page or an identity."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from ..core.types import Sample
from ..corruptions.registry import IMAGE_PAIR
from ..data.benchmarks import Benchmark
from ..data.benchmarks.benchmark import AnyCorruption
from ..metrics.rows import CLEAN, rows_frame
from ..models.objects import as_model
from ..models.protocols import AnyModel
from .comparable import measured_cells, sample_set_of
from .engines.processes import SERIAL
from .plan import NamedModel
from .setup import set_up
from .summary import Averages, summarize


class SamplesInMemory:
    """Loaded samples as a dataset; satisfies `Dataset`."""

    name = "samples"

    def __init__(self, samples: Iterable[Sample]) -> None:
        self._samples = {sample.key: sample for sample in samples}
        self.has_flow = all(sample.flow is not None for sample in self._samples.values())

    def keys(self) -> list[str]:
        return list(self._samples)

    def load(self, key: str) -> Sample:
        return self._samples[key]

    def files(self, key: str) -> list[Path]:
        return []


class Validated(NamedTuple):
    """The rows of a validation, with the columns of `robustflow.metrics.rows.ROW_SCHEMA`, and their means."""

    rows: pl.DataFrame
    averages: Averages

    @property
    def clean_pairs(self) -> str:
        """A name that identifies the measured clean frames and their ground truth."""
        return sample_set_of("", measured_cells(self.rows.filter(corruption=CLEAN)))


def validate(
    model: AnyModel | Callable[..., Any],
    samples: Benchmark | Iterable[Sample],
    corruptions: Sequence[AnyCorruption] | None = None,
    severities: Sequence[int] | None = None,
) -> Validated:
    """Measure a model on the clean frames of samples, and under corruptions, with the cells and the means of a run.

    Args:
        model: a loaded model, a PyTorch module, or a function of two frames.
        samples: the samples, each with its own key; or a benchmark, whose samples are read one after the other.
        corruptions: names of corruptions or families; by default those of the benchmark, none for samples.
        severities: severities from 1 to 5; by default those of the benchmark, all for samples.

    Raises:
        UsageError: a corruption is unknown or does not suit the samples, or a severity is outside 1 to 5.
        ModelError: the model fails, or returns values that are NaN or infinite.

    >>> from robustflow.testing import ConstantFlow
    >>> import numpy as np
    >>> frame, flow = np.zeros((16, 24, 3), np.uint8), np.zeros((16, 24, 2), np.float32)
    >>> sample = Sample("a", (frame, frame), flow, np.ones((16, 24), bool))
    >>> validated = validate(ConstantFlow(3, 4), [sample], ["fog"], [3])
    >>> validated.averages.mean("epe", "clean"), validated.averages.mean("cre"), validated.rows.height
    (5.0, 0.0, 2)
    """
    benchmark = samples if isinstance(samples, Benchmark) else _benchmark_of(samples)
    if corruptions:
        benchmark = benchmark.narrowed(corruptions, severities)
    elif corruptions is not None or benchmark is not samples:
        benchmark = replace(benchmark, corruptions=())
    plan = set_up(NamedModel(None, as_model(model, "the model"), {}), benchmark)
    with closing(SERIAL.compute(plan.job(), plan.units())) as finished:
        rows = rows_frame(row for unit in finished for row in unit.rows)
    return Validated(rows, summarize(rows, paper=benchmark.facts.paper_corruptions))


def _benchmark_of(samples: Iterable[Sample]) -> Benchmark:
    dataset = SamplesInMemory(samples)
    return Benchmark(dataset.name, dataset, tuple(dataset.keys()), IMAGE_PAIR)

"""Validation during training: measure the current network on a benchmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from ..core.errors import ModelError, UsageError
from ..core.text import counted
from ..metrics.rows import CLEAN
from ..models.protocols import FlowModel
from ..run.setup import open_benchmark
from ..run.validate import validate
from .request import Validation


class ValidationScores(NamedTuple):
    """The means of a validation, and a name that identifies its pairs."""

    numbers: dict[str, float]
    pairs: str


def validator(model: FlowModel, validation: Validation) -> Callable[[int], ValidationScores]:
    """Return a function that takes the number of updates and measures the model on a benchmark."""
    benchmark = open_benchmark(validation.benchmark, validation.data)
    benchmark = benchmark.narrowed(validation.corruptions or None, None, validation.limit)
    if not validation.corruptions:
        benchmark = replace(benchmark, corruptions=())
    if not benchmark.dataset.has_flow:
        raise UsageError(
            "--validate",
            f"{validation.benchmark}: this benchmark has no ground truth, so no error can be measured; "
            "choose a different one",
        )

    def scores(updates: int) -> ValidationScores:
        try:
            validated = validate(model, benchmark)
        except ModelError as error:
            raise ModelError(
                "--validate",
                f"after {counted(updates, 'update')}: {error}; the last checkpoint is kept: try a lower "
                "--learning-rate, or check the network in evaluation mode",
            ) from error
        averages = validated.averages
        means = {"epe": averages.mean("epe", CLEAN), "cre": averages.mean("cre"), "rcre": averages.mean("rcre")}
        return ValidationScores(
            {name: value for name, value in means.items() if value is not None}, validated.clean_pairs
        )

    return scores

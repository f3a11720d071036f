"""A user's request for a training run: recipe, data, checkpoints and validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..corruptions.stack import truth_under
from ..corruptions.transforms.transform import CorruptionTransform
from ..errors import UsageError
from ..random.rng import check_seed
from .recipe import Recipe

PAIRS_OF_VALIDATION = 20


@dataclass(frozen=True)
class DataPlan:
    """The data of a training run, and how they are read.

    Attributes:
        sources: folders of data, see `open_part`.
        corruptions: names of corruptions applied to training frames.
        probability: probability that a pair is corrupted, 0..1.
        skip_bad: whether to replace unreadable pairs, see `TrainingPairs`.
        loaders: number of processes that prepare batches in advance.
    """

    sources: Sequence[str | Path] = ()
    corruptions: Sequence[str] = ()
    probability: float = 0.5
    skip_bad: bool = False
    loaders: int = 1

    def __post_init__(self) -> None:
        _check_minimum(0, loaders=self.loaders)

    def corruption(self, seed: int) -> CorruptionTransform | None:
        """Return the corruption of the training frames; None for none.

        Raises:
            UsageError: a corruption is unknown or leaves no ground truth, or the probability is invalid.
        """
        if not self.corruptions:
            return None
        transform = CorruptionTransform(list(self.corruptions), probability=self.probability, seed=seed)
        if moving := [name for name in transform.names if truth_under(name) == "none"]:
            raise UsageError(f"--corrupt {moving[0]}: it moves content, so the ground truth would be wrong; omit it")
        return transform


@dataclass(frozen=True)
class Checkpoints:
    """The intervals at which weights are saved.

    Attributes:
        every: number of updates between checkpoints, each of which replaces the previous one.
        keep_every: number of updates between files of weights that are kept; None to keep none.
    """

    every: int = 1000
    keep_every: int | None = None

    def __post_init__(self) -> None:
        _check_minimum(1, save_every=self.every, keep_every=self.keep_every)


@dataclass(frozen=True)
class Validation:
    """The evaluation of the network during training.

    Attributes:
        benchmark: name of the benchmark.
        data: data of the benchmark, see `robustflow.evaluate`.
        every: number of updates between validations; None for one at each checkpoint.
        corruptions: corruptions to evaluate in addition to the clean frames.
        limit: number of pairs to use, spread evenly; None for all.
    """

    benchmark: str
    data: str | Path | None = None
    every: int | None = None
    corruptions: Sequence[str] = ()
    limit: int | None = PAIRS_OF_VALIDATION

    def __post_init__(self) -> None:
        _check_minimum(1, validate_every=self.every)


@dataclass(frozen=True)
class Request:
    """A training run requested by the user.

    Attributes:
        recipe: recipe with the user's changes.
        data: data to read.
        output: output folder of the training run.
        start: initial checkpoint, or "random"; None for the recipe's default.
        start_trained_on: training sets of the initial weights, if their file does not contain this information.
        resume: whether to continue from `last.pth`.
        seed: seed of all random draws.
        device: device as for `run --device`.
        options: options of the model.
        checkpoints: intervals at which weights are saved.
        validation: validation during training; None for none.
    """

    recipe: Recipe
    data: DataPlan
    output: Path
    start: str | None = None
    start_trained_on: str | None = None
    resume: bool = False
    seed: int = 0
    device: str = "auto"
    options: tuple[tuple[str, Any], ...] = ()
    checkpoints: Checkpoints = field(default_factory=Checkpoints)
    validation: Validation | None = None

    def __post_init__(self) -> None:
        if not 0 <= check_seed(self.seed) < 2**63:
            raise UsageError(f"--seed {self.seed}: give a number from 0 to {2**63 - 1}, the seeds of PyTorch")

    @property
    def validate_every(self) -> int | None:
        """Return the number of updates between validations; None for no validation."""
        return None if self.validation is None else self.validation.every or self.checkpoints.every


def _check_minimum(least: int, **numbers: int | None) -> None:
    for name, number in numbers.items():
        if number is not None and number < least:
            raise UsageError(f"--{name.replace('_', '-')} must be at least {least}; got {number}")

"""A user's request for a training run: recipe, data, checkpoints and validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import UsageError
from ..core.rng import check_seed
from ..corruptions.transform import CorruptionTransform
from .recipe import Recipe

PAIRS_OF_VALIDATION = 20


@dataclass(frozen=True)
class DataPlan:
    """The data of a training run, and how they are read."""

    sources: Sequence[str | Path] = ()
    corruptions: Sequence[str] = ()
    probability: float = 0.5
    skip_bad: bool = False
    loaders: int = 1

    def __post_init__(self) -> None:
        _check_minimum(0, loaders=self.loaders)

    def corruption(self, seed: int) -> CorruptionTransform | None:
        """Return the corruption of the training frames; None for none."""
        if not self.corruptions:
            return None
        transform = CorruptionTransform(list(self.corruptions), probability=self.probability, seed=seed)
        if moving := [corruption.name for corruption, _ in transform.choices if corruption.truth == "none"]:
            raise UsageError("--corrupt", f"{moving[0]}: it moves content, so the ground truth would be wrong; omit it")
        return transform


@dataclass(frozen=True)
class Checkpoints:
    """The intervals at which weights are saved."""

    every: int = 1000
    keep_every: int | None = None

    def __post_init__(self) -> None:
        _check_minimum(1, save_every=self.every, keep_every=self.keep_every)


@dataclass(frozen=True)
class Validation:
    """The evaluation of the network during training."""

    benchmark: str
    data: str | Path | None = None
    every: int | None = None
    corruptions: Sequence[str] = ()
    limit: int | None = PAIRS_OF_VALIDATION

    def __post_init__(self) -> None:
        _check_minimum(1, validate_every=self.every)


@dataclass(frozen=True)
class Request:
    """A training run requested by the user."""

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
            raise UsageError("--seed", f"{self.seed}: give a number from 0 to {2**63 - 1}, the seeds of PyTorch")

    @property
    def validate_every(self) -> int | None:
        """Return the number of updates between validations; None for no validation."""
        return None if self.validation is None else self.validation.every or self.checkpoints.every


def _check_minimum(least: int, **numbers: int | None) -> None:
    for name, number in numbers.items():
        if number is not None and number < least:
            raise UsageError(f"--{name.replace('_', '-')}", f"must be at least {least}; got {number}")

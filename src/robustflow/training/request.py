"""A user's request for a training: recipe, data, checkpoints and validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..corruptions.transforms.transform import CorruptionTransform
from .recipe import Recipe

PAIRS_OF_VALIDATION = 20


@dataclass(frozen=True)
class DataPlan:
    """What a training reads, and how.

    Attributes:
        sources: folders, see `open_part`.
        corruptions: applied to training frames.
        probability: that a pair is corrupted.
        skip_bad: see `TrainingPairs`.
        loaders: processes that prepare batches in advance.
    """

    sources: Sequence[str | Path] = ()
    corruptions: Sequence[str] = ()
    probability: float = 0.5
    skip_bad: bool = False
    loaders: int = 1

    def corruption(self, seed: int) -> CorruptionTransform | None:
        """What corrupts the training frames; None for nothing.

        Raises:
            UsageError: unknown corruptions, or an invalid probability.
        """
        if not self.corruptions:
            return None
        return CorruptionTransform(list(self.corruptions), probability=self.probability, seed=seed)


@dataclass(frozen=True)
class Checkpoints:
    """How often the weights are saved.

    Attributes:
        every: updates between checkpoints, each of which replaces the last.
        keep_every: updates between files of weights that are kept; None to keep none.
    """

    every: int = 1000
    keep_every: int | None = None


@dataclass(frozen=True)
class Validation:
    """What the network is measured on while it is trained.

    Attributes:
        benchmark: its name.
        data: its data, see `robustflow.evaluate`.
        every: updates between validations; None for one at each checkpoint.
        corruptions: besides the clean frames.
        limit: use only so many of its pairs, spread evenly.
    """

    benchmark: str
    data: str | Path | None = None
    every: int | None = None
    corruptions: Sequence[str] = ()
    limit: int | None = PAIRS_OF_VALIDATION


@dataclass(frozen=True)
class Request:
    """A training as the user requests it.

    Attributes:
        recipe: with the user's changes.
        data: what is read.
        output: the training's folder.
        start: a checkpoint to start from, or "random"; None for what the recipe starts from.
        start_trained_on: what those weights were trained on, if their file does not say.
        resume: continue from `last.pth`.
        seed: of every draw.
        device: as for `run --device`.
        options: of the model.
        checkpoints: when the weights are saved.
        validation: what is measured on the way; None for nothing.
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

    @property
    def validate_every(self) -> int | None:
        """Updates between validations; None for none."""
        return None if self.validation is None else self.validation.every or self.checkpoints.every

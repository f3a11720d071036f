"""What an engine receives and returns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...datasets.base import Dataset
from ...models import ModelSpec
from ...models.base import AnyModel
from ...runs.plan import RunOptions, Unit
from ...runs.store import RunFolder
from ..seconds import pop_timings
from ..worker import Worker


@dataclass(frozen=True)
class Job:
    """Everything that a worker needs; picklable if the model is."""

    dataset: Dataset
    model: ModelSpec | AnyModel
    options: RunOptions
    folder: Path
    batch_size: int = 1
    loaded: AnyModel | None = field(default=None, compare=False)
    """The model, if this process has loaded it already; it is never sent to another process."""
    kept: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    """Clean rows that the run already holds, by sample: a continued sample must give the same row again."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "loaded": None}

    def load_model(self) -> AnyModel:
        """The model; loads it if necessary."""
        if self.loaded is not None:
            return self.loaded
        return self.model.load() if isinstance(self.model, ModelSpec) else self.model

    def worker(self, on_predict: Callable[[str | None], None] = lambda what: None) -> Worker:
        """A worker with the model that `load_model` returns."""
        clean_path = RunFolder(self.folder).clean_path
        model = self.load_model()
        return Worker(self.dataset, model, self.options, clean_path, on_predict, self.batch_size, self.kept)


@dataclass(frozen=True)
class FinishedUnit:
    """A finished unit: its rows, and the seconds spent by kind of work."""

    unit: Unit
    rows: list[dict[str, Any]]
    seconds: dict[str, float]
    place: str | None = None
    """Node and device that computed it, if the engine has several."""


@dataclass(frozen=True)
class Engine:
    """A way to compute units.

    Attributes:
        describe: the engine in a few words, for the given units.
        compute: computes each unit once, in any order that puts a sample's clean unit first.
    """

    describe: Callable[[Sequence[Unit]], str]
    compute: Callable[[Job, Sequence[Unit]], Iterator[FinishedUnit]]


def take_seconds(worker: Worker) -> dict[str, float]:
    """The seconds since the last call."""
    return pop_timings(worker.seconds)

"""What an engine gets and what it gives back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ...datasets.base import Dataset
from ...models import ModelSpec
from ...models.base import AnyModel
from ...runs.plan import Settings, Unit
from ...runs.store import RunFolder
from ..worker import Worker


@dataclass(frozen=True)
class Job:
    """All a worker needs, picklable where the model is."""

    dataset: Dataset
    model: ModelSpec | AnyModel
    settings: Settings
    folder: Path
    batch_size: int = 1

    def worker(self, on_predict: Callable[[str | None], None] = lambda what: None) -> Worker:
        """A worker with its own model where the model is given by name."""
        model = self.model.load() if isinstance(self.model, ModelSpec) else self.model
        return Worker(
            self.dataset, model, self.settings, RunFolder(self.folder).clean_path, on_predict, self.batch_size
        )


@dataclass(frozen=True)
class Done:
    """A finished unit: its rows, and the seconds spent by kind of work."""

    unit: Unit
    rows: list[dict[str, Any]]
    seconds: dict[str, float]


class Engine(Protocol):
    """Computes units, each once, in any order that puts a sample's clean unit first."""

    def __call__(self, job: Job, units: Iterable[Unit]) -> Iterator[Done]: ...


def take_seconds(worker: Worker) -> dict[str, float]:
    """The seconds since the last call."""
    seconds = dict(worker.seconds)
    worker.seconds = dict.fromkeys(seconds, 0.0)
    return seconds

"""What every engine has: what it receives and returns, and the choice of the next unit for an idle worker."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from ...core.errors import UsageError, class_and_message
from ...core.plugins import called
from ...core.user_script import user_script
from ...metrics.rows import CLEAN
from ..computation import FinishedUnit
from ..plan import Job, Unit

FinishedUnits = Generator[FinishedUnit, None, None]
"""Finished units in the order in which they are computed; closing it ends the engine."""


@dataclass(frozen=True)
class Engine:
    describe: Callable[[Sequence[Unit]], str]
    compute: Callable[[Job, Sequence[Unit]], FinishedUnits]


def crash_of(model: str) -> str:
    """Describe the cause of a crash of a worker, and the remedy."""
    return f"native code of model {model}, or of a library, failed; report it to its authors, or leave the sample out"


def pickled(job: Job, dumps: Callable[[Any], bytes] = pickle.dumps) -> bytes:
    """Return a job as it is sent to other processes."""
    try:
        sent = dumps(job)
    except Exception as error:
        culprit, advice = "dataset or corruption", "use engine='serial' without a timeout"
        try:
            dumps(job.model)
        except Exception:
            culprit, advice = "model", f"{advice}, or name the model as 'module:attribute'"
        why = class_and_message(error)
        raise UsageError(culprit, f"cannot be sent to worker processes ({why}); {advice}") from error
    if dumps is pickle.dumps and b"__main__" in sent and user_script() is None:
        culprit = "class defined in a notebook or at a prompt"
        raise UsageError(culprit, "cannot be sent to worker processes; define it in a file and import it from there")
    return sent


def unpickled(sent: bytes) -> Any:
    """Return, in a worker process, the job or the model that was sent to it."""
    what, advice = "model, dataset or corruption", "define classes at the top level of a module, and test pickling them"
    return called(what, "restoring it in a worker process", partial(pickle.loads, sent), advice)


class Schedule:
    """Assign units so that a sample's clean flow is computed first, a worker continues with the sample it has
    loaded, and as few samples as possible are in progress. After the clean unit, a sample's units are assigned in
    reverse order, because the costliest corruption (psf_blur) is at the end of the plan: if it started last, one
    worker would be busy while the others are idle.
    """

    def __init__(self, units: Iterable[Unit]) -> None:
        self._waiting: dict[str, deque[Unit]] = {}
        """Units by sample, with the samples in the plan's order."""
        self.left = 0
        """Number of units that are not assigned."""
        for self.left, unit in enumerate(units, start=1):
            self._waiting.setdefault(unit.key, deque()).append(unit)
        self._fresh = [key for key, mine in reversed(self._waiting.items()) if mine[0].corruption == CLEAN]
        """Samples that no worker has started, in reverse order."""
        self._blocked: set[str] = set()
        """Samples whose clean unit is being computed; only its worker may have their other units."""

    def take(self, last_key: str | None) -> Unit | None:
        """Return the next unit for a worker that was last given one of `last_key`; None if it has to wait."""
        key = last_key if last_key in self._waiting else None
        if key is None and self._fresh:  # prefer a new sample, because two workers on the same sample load it twice
            key = self._fresh.pop()
            self._blocked.add(key)
        if key is None:
            key = next((key for key in self._waiting if key not in self._blocked), None)
        if key is None:
            return None
        waiting = self._waiting[key]
        unit = waiting.popleft() if waiting[0].corruption == CLEAN else waiting.pop()
        if not waiting:
            del self._waiting[key]
        self.left -= 1
        return unit

    def finished(self, unit: Unit) -> None:
        """Record that a unit is done; a clean unit allows other workers to help with its sample."""
        if unit.corruption == CLEAN:
            self._blocked.discard(unit.key)

    def give_back(self, unit: Unit) -> None:
        """Put a unit whose worker was lost back into the queue, ahead of the rest of its sample."""
        waiting = self._waiting.setdefault(unit.key, deque())
        self.left += 1
        if unit.corruption == CLEAN:
            waiting.appendleft(unit)
            self._blocked.discard(unit.key)
            self._fresh.append(unit.key)
        else:
            waiting.append(unit)

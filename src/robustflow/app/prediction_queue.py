"""Run predictions one at a time in a thread, skipping outdated requests."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..core.errors import RobustFlowError

Message = dict[str, Any]


class OutdatedError(Exception):
    """The job is outdated."""


@dataclass(eq=False)
class QueuedPrediction:
    """A job for which a page is waiting."""

    page: str
    work: Callable[[Callable[[str], None]], Message]
    tell: Callable[[Message], None]
    outdated: threading.Event = field(default_factory=threading.Event)

    def stage(self, name: str) -> None:
        """Report the current stage, unless the job is outdated."""
        if self.outdated.is_set():
            raise OutdatedError
        self.tell({"stage": name})


class PredictionQueue:
    """A queue that runs the newest job of each page in order of arrival, in a daemon thread."""

    def __init__(self) -> None:
        self._waiting: dict[str, QueuedPrediction] = {}
        """The waiting job of each page."""
        self._current: QueuedPrediction | None = None
        self._change = threading.Condition()
        threading.Thread(target=self._work, name="predictions", daemon=True).start()

    def submit(self, job: QueuedPrediction) -> None:
        """Add a job; earlier jobs of the same page become outdated."""
        with self._change:
            self._dismiss(job.page)
            self._waiting[job.page] = job
            self._change.notify()

    def close(self) -> None:
        """Release every waiting page; a prediction in progress continues to its end."""
        with self._change:
            for job in (*self._waiting.values(), self._current):
                if job is not None:
                    self._dismiss(job.page)

    def _dismiss(self, page: str) -> None:
        """End the jobs of a page, and tell it immediately."""
        for job in (self._waiting.pop(page, None), self._current):
            if job is not None and job.page == page:
                job.outdated.set()
                job.tell({"outdated": True})

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: bool(self._waiting))
                job = self._current = self._waiting.pop(next(iter(self._waiting)))
            job.tell(_outcome(job))
            with self._change:
                self._current = None


def _outcome(job: QueuedPrediction) -> Message:
    try:
        job.stage("starting")
        return {"result": job.work(job.stage)}
    except OutdatedError:
        return {"outdated": True}
    except RobustFlowError as error:
        return {"error": " ".join(str(error).split())}
    except (Exception, SystemExit) as error:  # a model that exits must not end the worker
        traceback.print_exc(file=sys.stderr)
        return {"error": f"the app failed ({type(error).__name__}); see the terminal in which it was started"}

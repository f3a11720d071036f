"""Limit the duration of a prediction."""

from __future__ import annotations

import time

from ...errors import ModelError


class PredictionTimeout:
    """Monitor the predictions of one process."""

    def __init__(self, timeout: float | None) -> None:
        self._timeout = timeout
        self._since = 0.0
        self.what: str | None = None
        """Description of the current prediction."""

    def note(self, what: str | None) -> None:
        """Record the start of a prediction, or its end if `what` is None."""
        self.what, self._since = what, time.monotonic()

    def check(self) -> None:
        """Check the duration of the current prediction."""
        if self._timeout is not None and self.what is not None and time.monotonic() - self._since > self._timeout:
            raise too_slow(self._timeout, self.what)


def too_slow(timeout: float, what: str) -> ModelError:
    """Return the error for a model that takes longer than `timeout` seconds on `what`."""
    return ModelError(f"the model took longer than {timeout:g} s on {what}; fix it, or allow more time with --timeout")

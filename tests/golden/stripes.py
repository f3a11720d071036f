"""A user's corruption in a file of its own, because the file is part of a run's identity."""

from __future__ import annotations

from typing import Any

import numpy as np


class Stripes:
    """A user's corruption: every n-th row becomes black."""

    severities = (32, 16, 8, 4, 2)

    def draw(self, rng: Any, severity: int, shape: tuple[int, int]) -> int:
        return self.severities[severity - 1]

    def apply(self, frame: np.ndarray, state: int, index: int) -> np.ndarray:
        striped = frame.copy()
        striped[::state] = 0
        return striped

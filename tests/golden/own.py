"""A user's models and corruption, in a file of their own, because the file is part of a run's identity."""

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


def brightness_flow(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A flow that depends on every pixel of both frames, computed with integer arithmetic only."""
    u = -(frame1.astype(np.int32).sum(axis=2) // 8)
    v = (frame2.astype(np.int32).sum(axis=2) - frame1.astype(np.int32).sum(axis=2)) // 16
    return np.stack([u, v], axis=2).astype(np.float32)


def partly_invalid_flow(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """`brightness_flow` without values where the first frame is bright."""
    flow = brightness_flow(frame1, frame2)
    flow[frame1[..., 0] > 200] = np.nan
    return flow

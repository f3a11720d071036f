"""Erase rectangles in the second frame, filling them with its mean colour, to simulate occlusion (RAFT)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...random.rng import Rng
from ...sample import Frame

_PROBABILITY = 0.5
_SIDES = (50, 100)
"""Range of the side length in pixels, excluding the upper limit."""


class Rectangle(NamedTuple):
    """A rectangle in pixels; it may extend beyond the frame."""

    left: int
    top: int
    width: int
    height: int


def draw_eraser(rng: Rng, shape: tuple[int, int]) -> tuple[Rectangle, ...]:
    """Draw one or two rectangles with probability 1/2, otherwise none, anywhere in a frame of `shape` (H, W)."""
    if rng.uniform() >= _PROBABILITY:
        return ()
    height, width = shape
    return tuple(
        Rectangle(rng.integer(0, width), rng.integer(0, height), rng.integer(*_SIDES), rng.integer(*_SIDES))
        for _ in range(rng.integer(1, 3))
    )


def erase(frame: Frame, rectangles: tuple[Rectangle, ...]) -> Frame:
    """Return the frame with the rectangles filled, or the frame itself if there are none."""
    if not rectangles:
        return frame
    colour = frame.reshape(-1, 3).mean(axis=0).astype(np.uint8)  # truncated, as when assigning to uint8
    erased = frame.copy()
    for left, top, width, height in rectangles:
        erased[top : top + height, left : left + width] = colour
    return erased

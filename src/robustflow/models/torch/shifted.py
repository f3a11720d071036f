"""Pairs of textures with known shifts, which any working flow network can estimate."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...core.types import Flow, Frame

SHIFTS = ((3, -2), (-4, 1), (2, 5), (-1, -4), (5, 3), (-5, -3), (4, -5), (-2, 4))
"""Shifts (u, v) in pixels, one per pair, in different directions."""
_MARGIN = 8
BORDER = 16
"""Number of pixels ignored along each side, where content that enters or leaves the frame has no match."""


class ShiftedPair(NamedTuple):
    """A pair of frames, RGB uint8 (H, W, 3), and the shift (u, v) between them in pixels."""

    frame1: Frame
    frame2: Frame
    shift: tuple[int, int]

    def error(self, flow: Flow) -> float:
        """Return the mean end-point error in pixels of a flow (H, W, 2), excluding the border; infinite if the flow is
        not finite.
        """
        inner = flow[BORDER:-BORDER, BORDER:-BORDER]
        error = float(np.hypot(inner[..., 0] - self.shift[0], inner[..., 1] - self.shift[1]).mean())
        return error if np.isfinite(error) else float("inf")

    def smoothed(self, flow: Flow) -> Flow:
        """Return a flow (H, W, 2) that is constant: the median of a flow, excluding the border; 0 if it is not
        finite.
        """
        vector = np.median(flow[BORDER:-BORDER, BORDER:-BORDER].reshape(-1, 2), axis=0)
        return np.full_like(flow, vector if np.isfinite(vector).all() else 0)


def shifted_pair(index: int, height: int = 128, width: int = 192) -> ShiftedPair:
    """Return the pair with the given number; it is identical on every call."""
    rng = np.random.default_rng(index)
    u, v = SHIFTS[index % len(SHIFTS)]
    size = (height + 2 * _MARGIN, width + 2 * _MARGIN)
    texture = np.full((*size, 3), (130.0, 122.0, 110.0))
    for cell, contrast in ((64, 34.0), (32, 28.0), (16, 22.0), (8, 18.0), (4, 12.0), (2, 6.0)):
        coarse = (size[1] // cell + 4, size[0] // cell + 4)
        grey = rng.normal(size=(coarse[1], coarse[0], 1))
        colours = 0.75 * grey + 0.45 * rng.normal(size=(coarse[1], coarse[0], 3))
        fine = cv2.resize(colours, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)
        texture += contrast * fine[: size[0], : size[1]]
    pixels = np.clip(np.rint(texture), 0, 255).astype(np.uint8)
    first = pixels[_MARGIN : _MARGIN + height, _MARGIN : _MARGIN + width]
    second = pixels[_MARGIN - v : _MARGIN - v + height, _MARGIN - u : _MARGIN - u + width]
    return ShiftedPair(np.ascontiguousarray(first), np.ascontiguousarray(second), (u, v))

"""Pairs of textures with a known shift: the smallest thing that a network of optical flow gets right."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...sample import Flow, Frame

SHIFTS = ((3, -2), (-4, 1), (2, 5), (-1, -4), (5, 3), (-5, -3), (4, -5), (-2, 4))
"""(u, v) in pixels, one for each pair: every direction, and none twice."""
_MARGIN = 8
BORDER = 16
"""Pixels along each side that are not measured: what moves in or out there has no counterpart."""


class ShiftedPair(NamedTuple):
    """Two frames, RGB uint8 (H, W, 3), and the shift (u, v) between them in pixels."""

    frame1: Frame
    frame2: Frame
    shift: tuple[int, int]

    def error(self, flow: Flow) -> float:
        """Mean end-point error of a flow (H, W, 2) away from the border, pixels; infinite where it is not finite."""
        inner = flow[BORDER:-BORDER, BORDER:-BORDER]
        error = float(np.hypot(inner[..., 0] - self.shift[0], inner[..., 1] - self.shift[1]).mean())
        return error if np.isfinite(error) else float("inf")


def shifted_pair(index: int, height: int = 128, width: int = 192) -> ShiftedPair:
    """One of the pairs; the same number gives the same bytes.

    >>> pair = shifted_pair(0)
    >>> (pair.frame2[8:, 8:][:9, :9] == pair.frame1[10:, 5:][:9, :9]).all()
    np.True_
    """
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

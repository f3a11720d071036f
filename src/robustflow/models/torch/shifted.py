"""Pairs of textures with a known shift: the least that a flow network gets right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from ...sample import Flow, Frame

SHIFTS = ((3, -2), (-4, 1), (2, 5), (-1, -4), (5, 3), (-5, -3), (4, -5), (-2, 4))
"""(u, v) in pixels, one for each pair, each in a different direction."""
_MARGIN = 8
_SHRUNKEN = 3.0
"""Factor by which the flow of a weak network may be too short."""
_EXACT = 1.25
"""Largest factor at which a flow still counts as being in pixels."""
_UNEXPLAINED = 0.1
"""Largest share of the variance of the shifts that may be unexplained if a network measures them."""
BORDER = 16
"""Pixels along each side that are not measured, because what moves in or out has no counterpart."""


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

    def vector(self, flow: Flow) -> tuple[float, float]:
        """Median (u, v) of a flow (H, W, 2) away from the border, in its own units; (0, 0) where it is not finite."""
        inner = flow[BORDER:-BORDER, BORDER:-BORDER].reshape(-1, 2)
        u, v = np.median(inner, axis=0).tolist()
        return (u, v) if np.isfinite([u, v]).all() else (0.0, 0.0)


class Reading(NamedTuple):
    """How to interpret a network's flow so that it gives the shifts.

    Attributes:
        swapped: whether its first component is v.
        factors: what u and v have to be multiplied by to be in pixels.
        unexplained: share of the variance of the shifts that is left.
    """

    swapped: bool
    factors: tuple[float, float]
    unexplained: float

    @property
    def misread(self) -> bool:
        """Whether the network measures the motion but its flow is clearly not (u, v) in pixels. A factor of up to
        `_SHRUNKEN`
        is tolerated: the flow of a weak network is shorter than the motion.
        """
        return self.explains and (self.swapped or _apart(self.factors, _SHRUNKEN))

    @property
    def explains(self) -> bool:
        """Whether the network measures the motion, in whatever form."""
        return self.unexplained < _UNEXPLAINED

    def describe(self) -> str:
        """Describe what it returns instead.

        >>> Reading(False, (-1.02, -0.98), 0.01).describe()
        'it points the other way, as the flow from frame 2 to frame 1 does'
        >>> Reading(True, (20.1, -19.7), 0.01).describe()
        'its components are (v, u); the sign of v is the opposite; u has to be multiplied by 20 and v by 20'
        """
        words = ["its components are (v, u)"] if self.swapped else []
        u, v = self.factors
        if u < 0 and v < 0:
            words.append("it points the other way, as the flow from frame 2 to frame 1 does")
        elif u < 0 or v < 0:
            words.append(f"the sign of {'u' if u < 0 else 'v'} is the opposite")
        if _apart((abs(u), abs(v)), _EXACT):
            words.append(f"u has to be multiplied by {abs(u):.2g} and v by {abs(v):.2g}")
        return "; ".join(words)


def _apart(factors: tuple[float, float], limit: float) -> bool:
    """Whether one of the factors is not within a factor `limit` of 1."""
    return not all(1 / limit < factor < limit for factor in factors)


def reading_of(vectors: Sequence[tuple[float, float]]) -> Reading:
    """The interpretation that fits best.

    Args:
        vectors: of a network's flow on each pair (`ShiftedPair.vector`), in the order of `SHIFTS`.

    >>> reading_of([(-v / 20, -u / 20) for u, v in SHIFTS]).describe().partition(";")[0]
    'its components are (v, u)'
    """
    true = np.array(SHIFTS, np.float64)
    readings = []
    for swapped in (False, True):
        flow = np.array(vectors, np.float64)[:, :: -1 if swapped else 1]
        power = (flow**2).sum(axis=0)
        factors = np.divide((flow * true).sum(axis=0), power, out=np.zeros(2), where=power > 0)
        left = float(((true - factors * flow) ** 2).sum() / (true**2).sum())
        readings.append(Reading(swapped, (float(factors[0]), float(factors[1])), left))
    return min(readings, key=lambda reading: reading.unexplained)


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

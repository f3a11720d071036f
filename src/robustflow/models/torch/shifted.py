"""Pairs of textures with known shifts, which any working flow network can estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from ...sample import Flow, Frame

SHIFTS = ((3, -2), (-4, 1), (2, 5), (-1, -4), (5, 3), (-5, -3), (4, -5), (-2, 4))
"""Shifts (u, v) in pixels, one per pair, in different directions."""
_MARGIN = 8
_SHRUNKEN = 3.0
"""Maximum factor by which a weak network may underestimate the flow."""
_EXACT = 1.25
"""Largest scale factor at which a flow is still considered to be in pixels."""
_UNEXPLAINED = 0.1
"""Maximum unexplained fraction of the variance of the shifts at which a network is still considered to measure them."""
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

    def vector(self, flow: Flow) -> tuple[float, float]:
        """Return the median (u, v) of a flow (H, W, 2), excluding the border, in the flow's units; (0, 0) if it is not
        finite.
        """
        inner = flow[BORDER:-BORDER, BORDER:-BORDER].reshape(-1, 2)
        u, v = np.median(inner, axis=0).tolist()
        return (u, v) if np.isfinite([u, v]).all() else (0.0, 0.0)


class Reading(NamedTuple):
    """The interpretation of a network's flow that best explains the known shifts.

    Attributes:
        swapped: whether the flow's first component is v.
        factors: factors that convert u and v to pixels.
        unexplained: unexplained fraction of the variance of the shifts.
    """

    swapped: bool
    factors: tuple[float, float]
    unexplained: float

    @property
    def misread(self) -> bool:
        """Whether the network measures the motion, but its flow is clearly not (u, v) in pixels. A factor of up to
        `_SHRUNKEN` is tolerated, because weak networks underestimate the motion.
        """
        return self.explains and (self.swapped or _apart(self.factors, _SHRUNKEN))

    @property
    def explains(self) -> bool:
        """Whether the network measures the motion, in any format."""
        return self.unexplained < _UNEXPLAINED

    def describe(self) -> str:
        """Describe how the flow differs from (u, v) in pixels.

        >>> Reading(False, (-1.02, -0.98), 0.01).describe()
        'it has the opposite sign, like the flow from frame 2 to frame 1'
        >>> Reading(True, (20.1, -19.7), 0.01).describe()
        'its components are (v, u); the sign of v is inverted; u must be multiplied by 20 and v by 20'
        """
        words = ["its components are (v, u)"] if self.swapped else []
        u, v = self.factors
        if u < 0 and v < 0:
            words.append("it has the opposite sign, like the flow from frame 2 to frame 1")
        elif u < 0 or v < 0:
            words.append(f"the sign of {'u' if u < 0 else 'v'} is inverted")
        if _apart((abs(u), abs(v)), _EXACT):
            words.append(f"u must be multiplied by {abs(u):.2g} and v by {abs(v):.2g}")
        return "; ".join(words)


def _apart(factors: tuple[float, float], limit: float) -> bool:
    """Return whether either factor differs from 1 by more than a factor of `limit`."""
    return not all(1 / limit < factor < limit for factor in factors)


def reading_of(vectors: Sequence[tuple[float, float]]) -> Reading:
    """Return the best-fitting interpretation.

    Args:
        vectors: the network's median flow vector on each pair (`ShiftedPair.vector`), in the order of `SHIFTS`.

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
    """Return the pair with the given number; it is identical on every call.

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

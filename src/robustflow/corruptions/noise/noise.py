"""Base class for noise corruptions, with one random stream per frame.

Sample s of a frame (row-major, channels last) depends only on lane s of the frame's hash values: 32-bit lanes for
Gaussian and shot noise, and 16-bit lanes for impulse noise. Any part of a frame can therefore be computed
separately, and only integers are compared.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption

BLOCK = 256
"""Number of hash values computed at a time, chosen so that they fit in the L1 cache and the loop vectorises."""


@dataclass(frozen=True)
class NoiseState:
    """State for a pair: the amount of noise and the parent of both frames' random streams."""

    parameter: float
    stream: Rng

    def key(self, index: int) -> np.uint64:
        """Return the key of the random stream for frame `index`."""
        return np.uint64(self.stream.spawn("frame", index).key)


class Noise(Corruption):
    """Base class for Gaussian, impulse and shot noise."""

    family = "noise"

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoiseState:
        """Return the state: the amount of noise and the pair's random stream."""
        return NoiseState(float(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        """Add noise to one frame; the noise differs between frames."""
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        self.add(source, state.parameter, state.key(index), out)
        return out

    @abstractmethod
    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        """Write `source` with noise to `out`; both arrays are contiguous."""


def work_arrays(lane: type[np.uint16 | np.uint32]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the work arrays of a compiled loop: `BLOCK` hash values, their lanes in the same memory, and one table
    entry for each lane. A loop that created them itself would take twice as long to compile.
    """
    words = np.empty(BLOCK, np.uint64)
    lanes = words.view(lane)
    return words, lanes, np.empty_like(lanes)

"""The base of the three noises: the amount of noise, and a stream for each frame.

Sample s of a frame (row-major, channels last) is decided by lane s of the frame's hash words alone: 32-bit lanes for
Gaussian and shot noise, 16-bit lanes for impulse noise. So any part of a frame can be computed separately, and only
integers are compared.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption

BLOCK = 256
"""Hash words computed at a time, so that they stay in the first-level cache and the loop vectorises."""


@dataclass(frozen=True)
class NoiseState:
    """The state of a pair: the amount of noise, and the stream from which its frames' streams are made."""

    parameter: float
    stream: Rng

    def key(self, index: int) -> np.uint64:
        """The key of frame `index`."""
        return np.uint64(self.stream.spawn("frame", index).key)


class Noise(Corruption):
    """The base class of the three noises."""

    family = "noise"

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoiseState:
        """The state: the amount of noise, and the stream of the pair."""
        return NoiseState(float(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: NoiseState, index: int) -> Frame:
        """One frame with its own noise."""
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        self.add(source, state.parameter, state.key(index), out)
        return out

    @abstractmethod
    def add(self, source: Frame, parameter: float, key: np.uint64, out: Frame) -> None:
        """Write `source` with noise into `out`, both contiguous.

        Args:
            source: uint8 (H, W, 3).
            parameter: the amount of noise, as `severities` give it.
            key: of the frame's stream.
            out: uint8 (H, W, 3).
        """

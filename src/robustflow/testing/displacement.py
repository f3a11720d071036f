"""Measure how far a corruption moves the content of frames."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..corruptions.api import stream_for
from ..corruptions.base import Corruption
from ..sample import SceneDepth

_PERIOD, _PHASES, _BLOCK = 64, 4, 16
_AMPLITUDE = 100.0
_READABLE = 0.01
"""Fraction of the amplitude below which the waves of a block cannot be read, e.g. because an object hides them."""


def displacement(
    corruption: Corruption,
    severity: int,
    shape: tuple[int, int],
    index: int = 0,
    seed: int = 0,
    depth: SceneDepth | None = None,
) -> npt.NDArray[np.float64]:
    """Measure how far content moves, with frames whose grey values code the position."""
    state = corruption.draw_with_depth(stream_for(corruption, severity, seed, "displacement"), severity, shape, depth)
    found = []
    for places in np.indices(shape)[::-1]:
        angles = 2 * np.pi * places / _PERIOD
        read = np.zeros(shape, np.complex128)
        for turn in 2 * np.pi * np.arange(_PHASES) / _PHASES:
            wave = np.rint(127.5 + _AMPLITUDE * np.cos(angles + turn)).astype(np.uint8)
            out = corruption.apply(wave[..., None].repeat(3, axis=2), state, index)
            read += out.mean(axis=2) * np.exp(-1j * (angles + turn))
        rows, columns = (size // _BLOCK for size in shape)
        tiles = read[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
        mean = tiles.mean(axis=(1, 3)) * (2 / (_PHASES * _AMPLITUDE))
        found.append(np.where(np.abs(mean) > _READABLE, np.angle(mean) * _PERIOD / (2 * np.pi), np.nan))
    return np.stack(found, axis=2)


def distortion(first: npt.NDArray[np.float64], second: npt.NDArray[np.float64]) -> float:
    """Return by how many pixels two frames are distorted: the mean deviation from the shift common to both, or 0 if no
    waves can be read.
    """
    both = np.stack([first, second]).reshape(-1, 2)
    both = both[np.isfinite(both).all(axis=1)]
    return float(np.hypot(*(both - both.mean(axis=0)).T).mean()) if len(both) else 0.0

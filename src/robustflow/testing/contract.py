"""Test frames and assertions shared by the checkers of user-defined attacks, corruptions and datasets."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import UsageError
from ..sample import Frame


def require(holds: Any, message: str) -> None:
    """Raise a `UsageError` with a message unless a condition holds."""
    if not holds:
        raise UsageError(message)


def frames_of(shape: tuple[int, int]) -> list[Frame]:
    """Return test frames (H, W, 3): a texture, the same texture shifted by one pixel, black, and white."""
    rows, columns = np.indices(shape)
    texture = np.stack([(rows * 7 + columns * step) % 256 for step in (3, 5, 11)], axis=-1).astype(np.uint8)
    return [texture, np.roll(texture, 1, axis=1), np.zeros_like(texture), np.full_like(texture, 255)]

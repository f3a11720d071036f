"""Convert a pair of frames to one array that an attack can change, and back to 8 bits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..sample import Frame

Images = npt.NDArray[np.float32]
"""Frames 1 and 2 as one array, RGB in 0..1, float32 (2, 3, H, W); their gradient has this shape too."""

WHITE = 255


def images_of(frame1: Frame, frame2: Frame) -> Images:
    """Convert a pair to the array that an attack changes.

    Args:
        frame1, frame2: RGB uint8 (H, W, 3).

    >>> images_of(np.full((4, 5, 3), 255, np.uint8), np.zeros((4, 5, 3), np.uint8))[:, 0, 0, 0].tolist()
    [1.0, 0.0]
    """
    pair = np.stack([frame1, frame2]).transpose(0, 3, 1, 2)
    return np.ascontiguousarray(pair, np.float32) / np.float32(WHITE)


def grey_levels_of(images: Images) -> npt.NDArray[np.int16]:
    """Round to grey levels 0..255, int16 (2, 3, H, W), as in a file."""
    return np.rint(np.clip(images, 0, 1) * np.float32(WHITE)).astype(np.int16)


def frames_of(levels: npt.NDArray[np.int16]) -> tuple[Frame, Frame]:
    """Grey levels (2, 3, H, W) as two frames, RGB uint8 (H, W, 3)."""
    first, second = np.ascontiguousarray(levels.transpose(0, 2, 3, 1), np.uint8)
    return first, second

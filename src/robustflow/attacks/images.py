"""Convert a pair of frames to a float array and back to 8 bits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..sample import Frame

Images = npt.NDArray[np.float32]
"""Both frames as one RGB array in 0..1, float32 (2, 3, H, W), or a gradient with respect to it."""

WHITE = 255


def images_of(frame1: Frame, frame2: Frame) -> Images:
    """Convert a pair to the array that an attack changes."""
    pair = np.stack([frame1, frame2]).transpose(0, 3, 1, 2)
    return np.ascontiguousarray(pair, np.float32) / np.float32(WHITE)


def grey_levels_of(images: Images) -> npt.NDArray[np.int16]:
    """Round images to grey levels 0..255, int16 (2, 3, H, W)."""
    return np.rint(np.clip(images, 0, 1) * np.float32(WHITE)).astype(np.int16)


def frames_of(levels: npt.NDArray[np.int16]) -> tuple[Frame, Frame]:
    """Convert grey levels (2, 3, H, W) to two frames, RGB uint8 (H, W, 3)."""
    first, second = np.ascontiguousarray(levels.transpose(0, 2, 3, 1), np.uint8)
    return first, second

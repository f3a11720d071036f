"""Render depth maps as greyscale images."""

from __future__ import annotations

import numpy as np

from ..sample import DepthMap, Frame


def depth_colours(depth: DepthMap) -> Frame:
    """Render a depth map in grey, with brightness proportional to inverse depth; the nearest pixel is white.

    >>> depth_colours(np.array([[2.0, 4.0, 200.0]], np.float32))[0, :, 0].tolist()
    [255, 128, 3]
    """
    grey = np.rint(255 * (depth.min() / depth)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)

"""Find the sky in KITTI's frames, which the laser scanner does not measure.

Sky is a bright area (blue at least 240, without parts narrower than five pixels) that reaches the upper edge of the
frame and of which less than one pixel in a hundred was measured. The last condition excludes sunlit walls: they
continue below the highest beam of the scanner. Sky enclosed by trees is missed.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..sample import Frame, Mask

_BRIGHT, _DETAIL = 240, 5
_MEASURED = 0.01


def sky(frame: Frame, measured: Mask) -> Mask:
    """Return the mask of the sky, bool (H, W)."""
    bright = cv2.morphologyEx((frame[..., 2] >= _BRIGHT).astype(np.uint8), cv2.MORPH_OPEN, np.ones((_DETAIL, _DETAIL)))
    count, areas = cv2.connectedComponents(bright, connectivity=4)
    sizes, known = np.bincount(areas.ravel(), minlength=count), np.bincount(areas[measured], minlength=count)
    is_sky = known < _MEASURED * sizes
    is_sky[0] = False
    is_sky &= np.isin(np.arange(count), areas[0])
    return np.asarray(is_sky[areas])

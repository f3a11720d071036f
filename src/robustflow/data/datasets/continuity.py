"""Whether the frames of a user's pairs are consecutive: equal frames, and frames of different scenes.

Frames share content where the flow from one to the other leads back, and the places that it connects look alike: the
match is the fraction of such pixels, on frames scaled to `_WIDTH`. On real footage it is 0.5 to 1, at 4 times the speed
0.18 and more; between different scenes at most 0.06 (0.13 on frames of 64 pixels).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from ...core.errors import DataError
from ...core.opencv import one_opencv_thread
from ...core.types import Frame

_WIDTH = 128
_LEAST_SIDE = 32
_WINDOW = (13, 13)
_LEAST_CORRELATION = 0.8
_LEAST_VARIANCE = 4.0
"""Variance in grey levels below which a window has no texture to compare."""

NO_MATCH = 0.13
"""Match below which frames may show different scenes."""
MATCH = 0.3
"""Match from which frames show the same scene."""
_RELATIVE = 0.25
"""A cut matches less than this fraction of the match before and after it."""
_KEPT_FRAMES = 64


class Sketch(NamedTuple):
    """What is kept of a frame: its bytes' hash, and the small grey frame, None if it is too small to be compared."""

    content: Hashable
    small: Any


def sketch_of(read: Callable[[Any], Frame], name: Hashable) -> Sketch:
    """Read and sketch a frame; one that cannot be read is not compared, and is reported when it is measured."""
    try:
        frame = read(name)
    except DataError:
        return Sketch(name, None)
    height, width = frame.shape[:2]
    scale = max(_WIDTH / max(height, width), _LEAST_SIDE / min(height, width))
    small: Any = None
    if min(height, width) >= _LEAST_SIDE:
        small = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        if scale < 1:
            small = cv2.resize(small, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
    return Sketch(hash(frame.tobytes()), small)


def match(first: Sketch, second: Sketch) -> float:
    """Return the fraction of pixels that show the same in both frames; 1 for frames that cannot be compared."""
    a, b = first.small, second.small
    if a is None or b is None or a.shape != b.shape:
        return 1.0
    with one_opencv_thread():
        still = _match(a, b, (0.0, 0.0))
        if still >= NO_MATCH:
            return still
        window = cv2.createHanningWindow(a.shape[::-1], cv2.CV_32F)
        shift, _ = cv2.phaseCorrelate(a.astype(np.float32), b.astype(np.float32), window)
        return max(still, _match(a, b, shift))  # a large motion of the camera


def _match(a: Any, b: Any, shift: Sequence[float]) -> float:
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    method.setFinestScale(0)
    start = np.full((*a.shape, 2), shift, np.float32)
    ahead, back = method.calc(a, b, start.copy()), method.calc(b, a, -start)
    height, width = a.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = x + ahead[..., 0], y + ahead[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    way_back = np.hypot(*np.moveaxis(ahead + cv2.remap(back, x, y, cv2.INTER_LINEAR), 2, 0))
    here, there = a.astype(np.float32), cv2.remap(b, x, y, cv2.INTER_LINEAR).astype(np.float32)
    (mean, mean_of_other), mean_of_product = map(_mean, (here, there)), _mean(here * there)
    variance, variance_of_other = _mean(here * here) - mean**2, _mean(there * there) - mean_of_other**2
    floor = np.maximum(variance, _LEAST_VARIANCE) * np.maximum(variance_of_other, _LEAST_VARIANCE)
    alike = (mean_of_product - mean * mean_of_other) / np.sqrt(floor) > _LEAST_CORRELATION
    alike |= (variance < _LEAST_VARIANCE) & (variance_of_other < _LEAST_VARIANCE)
    return float((inside & alike & (way_back < 0.5 + 0.05 * np.hypot(*np.moveaxis(ahead, 2, 0)))).mean())


def _mean(values: Any) -> Any:
    return cv2.boxFilter(values, -1, _WINDOW)


REPEATED, CUT, UNLIKE = "a repeated frame", "a cut", "no content"


def faults(
    pairs: Mapping[str, tuple[Hashable, Hashable]], keys: Sequence[str], read: Callable[[Any], Frame]
) -> dict[str, str]:
    """Compare the frames of some of the pairs; return for each why its frames are not consecutive, "" if they are."""
    before = {second: first for first, second in pairs.values()}
    after = dict(pairs.values())

    @lru_cache(_KEPT_FRAMES)
    def sketch(name: Hashable) -> Sketch:
        return sketch_of(read, name)

    @lru_cache(_KEPT_FRAMES)
    def matching(first: Hashable, second: Hashable) -> float:
        return match(sketch(first), sketch(second))

    def fault(first: Hashable, second: Hashable) -> str:
        if sketch(first).content == sketch(second).content:
            return REPEATED
        if (own := matching(first, second)) >= NO_MATCH:
            return ""
        around = [matching(before[first], first)] if first in before else []
        around += [matching(second, after[second])] if second in after else []
        is_cut = min(around, default=0.0) >= MATCH and own < _RELATIVE * min(around)
        return CUT if is_cut else UNLIKE

    return {key: fault(*pairs[key]) for key in keys}

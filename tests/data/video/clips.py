"""Small clips for tests: frames of the rendered scene and clips on disk."""

from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from robustflow.data.video.clip import ClipFile, write_clip
from robustflow.data.video.codec import Options, lossless, rgb_to_i420
from robustflow.data.video.variants import Fill
from robustflow.media.images import write_image

from .render import Scene


@cache
def frames(count: int, height: int = 48, width: int = 64, step: float = 1.0) -> tuple[np.ndarray, ...]:
    """Return RGB uint8 frames of a moving scene at intervals of `step` time units."""
    scene = Scene(height, width)
    return tuple(scene.frame(index * step) for index in range(count))


def shown_as(fill: Fill, index: int) -> int:
    """Return the decoded frame at the position of frame `index`."""
    return next((source for first, last, source in fill.lost if first <= index <= last), index)


def pictures(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    """Return the clip in I420."""
    return [rgb_to_i420(frame) for frame in frames(count, height, width)]


def clip(
    path: Path, count: int, height: int = 48, width: int = 64, encoding: Options | None = None, fps: int = 960
) -> ClipFile:
    encoding = encoding or lossless("veryfast")
    return write_clip(path, pictures(count, height, width), (height, width), Fraction(fps), encoding)


def folder(path: Path, count: int, height: int = 48, width: int = 64) -> Path:
    """Write the clip as PNG files."""
    path.mkdir(parents=True)
    for index, frame in enumerate(frames(count, height, width), start=1):
        write_image(path / f"{index:06d}.png", frame)
    return path

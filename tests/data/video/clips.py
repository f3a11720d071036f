"""Small clips for tests: frames of a rendered scene with real textures, whose image is known at any time, and files."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates
from skimage import data

from robustflow.data.video.clip import ClipFile, write_clip
from robustflow.data.video.codec import Options, lossless, rgb_to_i420
from robustflow.data.video.variants import Fill
from robustflow.media.images import write_image


@cache
def frames(count: int, height: int = 48, width: int = 64, step: float = 1.0) -> tuple[np.ndarray, ...]:
    """Return RGB uint8 frames of a moving scene at intervals of `step` time units."""
    scene = Scene(height, width)
    return tuple(scene.frame(index * step) for index in range(count))


def shown_as(fill: Fill, index: int) -> int:
    return next((source for first, last, source in fill.lost if first <= index <= last), index)


def pictures(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    return [rgb_to_i420(frame) for frame in frames(count, height, width)]


def clip(
    path: Path, count: int, height: int = 48, width: int = 64, encoding: Options | None = None, fps: int = 960
) -> ClipFile:
    encoding = encoding or lossless("veryfast")
    return write_clip(path, pictures(count, height, width), (height, width), Fraction(fps), encoding)


def folder(path: Path, count: int, height: int = 48, width: int = 64) -> Path:
    path.mkdir(parents=True)
    for index, frame in enumerate(frames(count, height, width), start=1):
        write_image(path / f"{index:06d}.png", frame)
    return path


def _texture(name: str) -> np.ndarray:
    image = getattr(data, name)()
    return image[..., :3].astype(np.float64)


@dataclass
class Scene:
    """Velocities of the background and the disk in pixels, and rotation `turn` in radians, each per unit of time."""

    height: int = 144
    width: int = 176
    background: tuple[float, float] = (2.0, 1.0)
    disk: tuple[float, float] = (-3.0, 1.5)
    turn: float = 0.0

    def __post_init__(self) -> None:
        self._back, self._front = _texture("astronaut"), _texture("coffee")

    def picture(self, time: float) -> np.ndarray:
        """RGB float64 (H, W, 3), 0 to 255."""
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        cos, sin = np.cos(self.turn * time), np.sin(self.turn * time)
        dx = x - self.width / 2 - self.background[0] * time
        dy = y - self.height / 2 - self.background[1] * time
        back = _bilinear(self._back, cos * dx + sin * dy + 220.0, -sin * dx + cos * dy + 160.0)
        x, y = x - self.disk[0] * time, y - self.disk[1] * time
        inside = np.hypot(x - self.width * 0.55, y - self.height * 0.4) < 0.22 * self.height
        return np.where(inside[..., None], _bilinear(self._front, x + 200.0, y + 120.0), back)

    def frame(self, time: float) -> np.ndarray:
        """RGB uint8 (H, W, 3)."""
        return np.rint(self.picture(time)).astype(np.uint8)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    channels = np.moveaxis(image, -1, 0)
    return np.stack([map_coordinates(channel, (y, x), order=1, mode="nearest") for channel in channels], axis=-1)

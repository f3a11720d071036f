"""A rendered scene with real textures, whose image is known at any time.

A textured background moves and slowly rotates; a textured disk moves across it. Everything is evaluated in float64 with
bilinear sampling at exact positions, so `picture(t)` shows the same continuous scene for any real `t`, and the mean of
many images has exact motion blur.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skimage import data


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
        x, y = self._grid()
        bx, by = self._to_background(x, y, time)
        out = _bilinear(self._back, bx, by)
        inside = self._in_disk(x, y, time)
        front = _bilinear(self._front, x - self.disk[0] * time + 200.0, y - self.disk[1] * time + 120.0)
        return np.where(inside[..., None], front, out)

    def frame(self, time: float) -> np.ndarray:
        """RGB uint8 (H, W, 3)."""
        return np.rint(self.picture(time)).astype(np.uint8)

    def _grid(self) -> tuple[np.ndarray, np.ndarray]:
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        return x, y

    def _in_disk(self, x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        cx, cy = self.width * 0.55 + self.disk[0] * time, self.height * 0.4 + self.disk[1] * time
        return np.hypot(x - cx, y - cy) < 0.22 * self.height

    def _to_background(self, x: np.ndarray, y: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        cos, sin = np.cos(self.turn * time), np.sin(self.turn * time)
        dx = x - self.width / 2 - self.background[0] * time
        dy = y - self.height / 2 - self.background[1] * time
        return cos * dx + sin * dy + 220.0, -sin * dx + cos * dy + 160.0


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    x, y = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
    x0, y0 = x.astype(int), y.astype(int)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    top = image[y0, x0] * (1 - fx) + image[y0, x0 + 1] * fx
    low = image[y0 + 1, x0] * (1 - fx) + image[y0 + 1, x0 + 1] * fx
    return top * (1 - fy) + low * fy

"""Textures for the shapes: dead leaves (shapes that overlap, as in photographs) with noise at several scales.

Dead leaves with radii r distributed as r^-3 have the spectrum and the edges of natural images (Lee, Mumford and Huang,
IJCV 2001). Textures repeat seamlessly. Only the four basic operations and the square root are used, so the bytes are
the same on every machine.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ....core.compiled import njit
from ....core.errors import UsageError
from ....core.paths import user_path
from ....core.rng import Rng
from ....media.images import images_in, read_image

SIZE = 512
"""Side length of a texture, in texels."""
COUNT = 32
"""Number of textures shared by the layers of all scenes."""
_LEAVES = 4000
_RADII = (4.0, 140.0)
_MOST_PICTURES = 256
"""Maximum number of user images; with this many, they take 200 MB of memory."""

TextureArray = npt.NDArray[np.uint8]
"""(count, SIZE, SIZE, 3), RGB."""


@lru_cache(maxsize=2)
def procedural_textures(seed: int, split: str) -> TextureArray:
    """Return the textures that all pairs of a seed share; they are generated once per process in a few seconds."""
    return np.stack([_texture(Rng.of(seed, "shapes", split, "texture", index)) for index in range(COUNT)])


@lru_cache(maxsize=2)
def picture_textures(folder: str) -> TextureArray:
    files = texture_files(folder)
    return np.stack([_covering(read_image(path)) for path in files])


def texture_files(folder: str) -> list[Path]:
    root = user_path(folder)
    if not root.is_dir():
        raise UsageError("textures", f"{folder} does not exist; give a folder of images")
    files = images_in(root)
    if not 1 <= len(files) <= _MOST_PICTURES:
        raise UsageError("textures", f"{folder} contains {len(files)} images; give 1 to {_MOST_PICTURES}")
    return files


def _covering(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    height, width = picture.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = picture[top : top + side, left : left + side]
    shrinks = side > SIZE
    return np.asarray(
        cv2.resize(square, (SIZE, SIZE), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8
    )


def _texture(rng: Rng) -> npt.NDArray[np.uint8]:
    contrast = 0.15 + 0.85 * rng.uniform()
    grey = rng.uniform(50, 205)
    base = np.array([grey + rng.uniform(-40, 40) for _ in range(3)])
    numbers = rng.uniforms(_LEAVES * 11).reshape(_LEAVES, 11)
    leaves = np.full((SIZE, SIZE, 3), -1.0)
    _paint(numbers, base, contrast, *_RADII, leaves)
    noise = np.zeros((SIZE, SIZE))
    strength = rng.uniform(2, 26)
    for cells, part in ((8, 1.0), (32, 0.7), (128, 0.5), (256, 0.4)):
        _add_noise(rng.uniforms(cells * cells).reshape(cells, cells) - 0.5, strength * part, noise)
    return np.rint(np.clip(leaves + noise[..., None], 0, 255)).astype(np.uint8)


@njit(cache=True, nogil=True)
def _paint(numbers: Any, base: Any, contrast: Any, smallest: Any, largest: Any, out: Any) -> None:
    """Draw leaves from front to back; each leaf fills its pixels that are still free, wrapping around the borders."""
    size = out.shape[0]
    free = size * size
    ratio = (smallest / largest) ** 2
    for leaf in range(numbers.shape[0]):
        n = numbers[leaf]
        radius = smallest / np.sqrt(1.0 - n[0] * (1.0 - ratio))
        cx, cy = n[1] * size, n[2] * size
        turn = 2.0 * n[3] - 1.0
        cosine, sine = (1.0 - turn * turn) / (1.0 + turn * turn), 2.0 * turn / (1.0 + turn * turn)
        flat = 0.25 + 0.75 * n[4]
        box = n[5] < 0.5
        lean = 60.0 * contrast * (n[6] - 0.5) / radius
        shade = (n[7] - 0.5) * 300.0 * contrast
        reach = int(np.ceil(radius * (1.5 if box else 1.0)))
        for dy in range(-reach, reach + 1):
            row = int(np.floor(cy + dy)) % size
            for dx in range(-reach, reach + 1):
                column = int(np.floor(cx + dx)) % size
                if out[row, column, 0] >= 0.0:
                    continue
                u, v = (cosine * dx + sine * dy) / radius, (cosine * dy - sine * dx) / (radius * flat)
                if max(abs(u), abs(v)) > 1.0 if box else u * u + v * v > 1.0:
                    continue
                for channel in range(3):
                    value = base[channel] + shade + 90.0 * contrast * (n[8 + channel] - 0.5) + lean * (dx + dy)
                    out[row, column, channel] = min(max(value, 0.0), 255.0)
                free -= 1
        if free == 0:
            return
    for row in range(size):
        for column in range(size):
            if out[row, column, 0] < 0.0:
                for channel in range(3):
                    out[row, column, channel] = base[channel]


@njit(cache=True, nogil=True)
def _add_noise(lattice: Any, strength: Any, out: Any) -> None:
    """Generate noise by bilinear interpolation of random values at lattice points, periodic without a seam."""
    size, cells = out.shape[0], lattice.shape[0]
    step = cells / size
    for row in range(size):
        v = row * step
        r0 = int(v)
        v -= r0
        r1 = (r0 + 1) % cells
        for column in range(size):
            u = column * step
            c0 = int(u)
            u -= c0
            c1 = (c0 + 1) % cells
            above = lattice[r0, c0] * (1.0 - u) + lattice[r0, c1] * u
            below = lattice[r1, c0] * (1.0 - u) + lattice[r1, c1] * u
            out[row, column] += strength * (above * (1.0 - v) + below * v)

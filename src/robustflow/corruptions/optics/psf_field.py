"""The PSFs of a lens over its field (64 points from centre to corner, 3 colours, 61 x 61 pixels), the kernels that
follow from them, and the files of the five shipped lenses.

The blur is out = sum over nodes of w_node * (image convolved with the kernel of the node), with triangular windows w
that sum to one: kernels are interpolated linearly between nodes 12 to 34 pixels apart. In small images, the nodes are
closer because the blur changes more from pixel to pixel. Nodes are symmetric about the image centre, so the mirrored
kernels of one quadrant cover the entire image.

Only half of each stack (columns 30 to 60) is stored, as float16, because a PSF of a centred lens is symmetric about its
meridional plane. `data/manifest.json` contains the SHA-256 of each lens and each stored half.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.arguments import SEVERITIES, check_severity
from ...core.compiled import njit
from ...core.errors import DataError
from ...media.arrays import DAMAGE

FIELDS = 64
SIZE = 61
"""Size of a PSF, and of the kernels that follow from it, in pixels."""
SHAPE = (FIELDS, 3, SIZE, SIZE)


class PsfField:
    """Normalised PSFs over the field."""

    def __init__(self, stack: npt.NDArray[Any]) -> None:
        """Build a field from a stack with arbitrary scaling; each PSF is divided by its sum."""
        values = np.asarray(stack, np.float64)
        if values.shape != SHAPE:
            raise DataError("PSF stack", f"expected the shape {SHAPE}, got {values.shape}")
        sums = values.sum((2, 3), keepdims=True)
        if not np.isfinite(values).all() or (sums <= 0.0).any():
            raise DataError("PSF stack", "a PSF is zero or has non-finite values")
        self.stack: npt.NDArray[np.float32] = np.ascontiguousarray(values / sums, np.float32)
        self.digest = hashlib.sha256(self.stack.tobytes()).hexdigest()


PITCHES = (34, 30, 24, 18, 12)
"""Maximum distances between nodes in pixels."""

FINENESS = 27.0
"""Minimum number of node spacings along half of the image diagonal, for diagonals of 648 pixels or more. The
interpolation error is inversely proportional to the square of the number of spacings, and the run time increases with
it; see docs/optics.md for measurements.
"""


def grid_of(height: int, width: int) -> int:
    """Return the entry of `PITCHES` for an image size."""
    limit = math.sqrt(height * height + width * width) / 2.0 / FINENESS
    return next((pitch for pitch in PITCHES if pitch <= limit), PITCHES[-1])


@dataclass(frozen=True)
class Axis:
    """The nodes along one image axis, from the centre to the last pixel; the other half is symmetric."""

    length: int
    pitch: float
    offsets: npt.NDArray[np.float64]
    starts: tuple[int, ...]
    windows: npt.NDArray[np.float64]

    @classmethod
    @lru_cache(maxsize=32)
    def of(cls, length: int, largest_pitch: int) -> Axis:
        """Return the smallest set of nodes that covers the axis from the centre to the last pixel."""
        count = max(1, math.ceil(((length - 1) / largest_pitch + 1.0) / 2.0))
        pitch = max((length - 1) / (2 * count - 1), 1.0)
        offsets = np.asarray((np.arange(count) + 0.5) * pitch, np.float64)
        places = (length - 1) / 2.0 + offsets
        starts = tuple(math.floor(place - pitch) + 1 for place in places)
        pixels = np.array(starts)[:, None] + np.arange(2 * largest_pitch)
        return cls(length, pitch, offsets, starts, np.maximum(1.0 - np.abs(pixels - places[:, None]) / pitch, 0.0))


_MARGIN = SIZE // 4 + 1
"""Pixels around a kernel in which its rotated corners lie; they are up to 0.21 times the size outside."""


def kernels_at(stack: Any, dx: Any, dy: Any, corner: float, out: Any) -> None:
    """Compute the kernels at image points (dx, dy) pixels from the image centre."""
    _rotate(stack, dx, dy, corner, np.zeros((SIZE + 2 * _MARGIN, SIZE + 2 * _MARGIN)), out)


@njit(cache=True, error_model="numpy")
def _rotate(stack: Any, dx: Any, dy: Any, corner: float, at_distance: Any, out: Any) -> None:
    """Interpolate a stack (64, 3, 61, 61) at each point's distance, turn it towards the point, and normalise it."""
    fields, colours, size, _ = stack.shape
    middle = (size - 1) / 2.0
    for p in range(dx.size):
        distance = np.sqrt(dx[p] * dx[p] + dy[p] * dy[p])
        cosine, sine = (dy[p] / distance, dx[p] / distance) if distance > 0.0 else (1.0, 0.0)
        place = np.minimum(distance / corner, 1.0) * (fields - 1)
        lower = np.minimum(np.int64(place), fields - 2)
        share = place - lower
        for colour in range(colours):
            for row in range(size):
                for column in range(size):
                    near = stack[lower, colour, row, column]
                    value = near + share * (stack[lower + 1, colour, row, column] - near)
                    at_distance[row + _MARGIN, column + _MARGIN] = value
            total = 0.0
            for row in range(size):
                for column in range(size):
                    x, y = column - middle, row - middle
                    along, across = cosine * y + sine * x + middle, cosine * x - sine * y + middle
                    i, j = np.int64(np.floor(along)), np.int64(np.floor(across))
                    a, b = along - i, across - j
                    i, j = i + _MARGIN, j + _MARGIN
                    value = (1.0 - a) * (1.0 - b) * at_distance[i, j] + (1.0 - a) * b * at_distance[i, j + 1]
                    value = value + a * (1.0 - b) * at_distance[i + 1, j] + a * b * at_distance[i + 1, j + 1]
                    out[p, colour, row, column] = value
                    total += value
            for row in range(size):
                for column in range(size):
                    out[p, colour, row, column] /= total


DATA = Path(str(resources.files(__package__))) / "data"
RMS_RADII = (0.0273, 0.0776, 0.1021, 0.1508, 0.1864)
"""Mean RMS radius of each lens over the field and the colours, in mm; 4 to 8 % below those in the paper."""
_MIDDLE = SIZE // 2


@lru_cache(maxsize=len(SEVERITIES))
def shipped_field(severity: int) -> PsfField:
    """Return the rendered PSFs of the lens for a severity."""
    path = DATA / f"psf_s{check_severity(severity)}.npz"
    try:
        with np.load(path, allow_pickle=False) as archive:
            half = archive["half"]
    except (OSError, *DAMAGE) as error:
        raise DataError(path, f"these PSFs cannot be read: {error}; reinstall robustflow") from error
    check_digest(f"psf_s{severity}", half_digest(half))
    return PsfField(whole(half))


def halved(field: PsfField) -> npt.NDArray[np.float16]:
    """Return the half of a field that is stored: columns 30 to 60, float16 (64, 3, 61, 31)."""
    return field.stack[..., _MIDDLE:].astype(np.float16)


def whole(half: npt.NDArray[np.float16]) -> npt.NDArray[np.float64]:
    """Restore the full stack (64, 3, 61, 61) from a stored half."""
    values = half.astype(np.float64)
    return np.concatenate([values[..., :0:-1], values], axis=-1)


def half_digest(half: npt.NDArray[np.float16]) -> str:
    """Return the SHA-256 of a stored half, regardless of the machine's byte order."""
    return hashlib.sha256(np.ascontiguousarray(half, "<f2").tobytes()).hexdigest()


def manifest() -> dict[str, str]:
    """Return the SHA-256 hashes by name: lens_s1 to lens_s5 and psf_s1 to psf_s5."""
    content: dict[str, str] = json.loads((DATA / "manifest.json").read_text(encoding="utf-8"))
    return content


def check_digest(name: str, digest: str) -> None:
    if manifest().get(name) != digest:
        raise DataError(name, f"differs from the shipped file (SHA-256) in {DATA}; reinstall robustflow")

"""Read depth and disparity maps: 16-bit greyscale PNG, .npy, one-channel .pfm, Sintel's .dpt and Spring's .dsp5.

Values are returned as stored, in the file's unit; unknown values are zero, NaN or infinite. Files are untrusted: sizes
are checked before memory is allocated, and nothing is unpickled.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError
from .arrays import claimed_size, exact_size, read_float_map, read_npy, readable
from .flow import read_dataset, read_png16

Values = npt.NDArray[np.float32]
"""A depth or disparity map, float32 (H, W)."""

_SINTEL = np.float32(202021.25)


def read_depth_png(path: Path) -> Values:
    with readable(path):
        return read_png16(path, 1, "a depth or disparity map, which is a 16-bit greyscale PNG").astype(np.float32)


def read_depth_npy(path: Path) -> Values:
    return _as_float(read_npy(path, "a depth map"))


def read_depth_pfm(path: Path) -> Values:
    with readable(path):
        return read_float_map(path, 1)[..., 0].astype(np.float32)


def read_dpt(path: Path) -> Values:
    """Read Sintel's .dpt: the number 202021.25, width and height as int32, then the rows as float32; little-endian."""
    with readable(path), open(path, "rb") as file:
        start = file.read(12)
        if len(start) < 12 or np.frombuffer(start[:4], "<f4")[0] != _SINTEL:
            raise DataError(path, "not a Sintel .dpt file, or truncated; copy or download it again")
        width, height = np.frombuffer(start[4:], "<i4").tolist()
        claimed_size(path, width, height)
        exact_size(path, 12 + 4 * width * height, path.stat().st_size, width, height)
        return np.fromfile(file, "<f4").reshape(height, width).astype(np.float32)


def read_camera(path: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Read Sintel's .cam: the number 202021.25 as float32, then intrinsics (3, 3) and world-to-camera extrinsics (3, 4)
    as float64; little-endian.
    """
    with readable(path):
        data = path.read_bytes() if path.stat().st_size == 4 + 8 * 21 else b""
        numbers = np.frombuffer(data, "<f8", offset=4) if data[:4] == _SINTEL.astype("<f4").tobytes() else None
        if numbers is None or not np.isfinite(numbers).all():
            raise DataError(path, "not a Sintel .cam file, or damaged; copy or download it again")
        return numbers[:9].reshape(3, 3), numbers[9:].reshape(3, 4)


def read_dsp5(path: Path) -> Values:
    """Read Spring's .dsp5: an HDF5 file with one float dataset "disparity" (H, W); requires the extra `h5`."""
    return _as_float(read_dataset(path, "disparity", ".dsp5", ()))


def _as_float(values: npt.NDArray[Any]) -> Values:
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(values, np.float32)

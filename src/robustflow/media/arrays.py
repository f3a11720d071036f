"""Parts shared by the readers of flow and depth: damaged files, sizes, unknown values; and the portable float map.

A portable float map (.pfm) is `PF` (three channels: u, v, unused; as in FlyingThings3D, Monkaa and Driving) or `Pf`
(one channel), width and height, a scale whose sign encodes the byte order (negative: little-endian), then float32 rows
from the bottom to the top of the image. Source: Mayer et al., CVPR 2016, and Debevec's description of the format.
"""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ..core.errors import DataError, first_line
from ..core.types import Flow, Mask, unmasked

MAX_SIDE = 99_999
"""Maximum width and height for all formats; the same limit as in Middlebury's own reader."""

MAX_PIXELS = 2**26
"""Maximum number of pixels, 67 million; larger files are rejected before decompression. Spring, the dataset with the
largest flow fields, has 8 million per file.
"""

UNKNOWN_THRESHOLD = 1e9
"""A component whose magnitude exceeds this threshold marks unknown flow, as in Middlebury's format."""


DAMAGE = (
    *(ValueError, TypeError, LookupError, EOFError, SyntaxError, MemoryError, RuntimeError),
    *(TokenError, BadZipFile, zlib.error),
)
"""Errors of the parsers of NumPy, OpenCV, HDF5 and zip on damaged files."""


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise a DataError in one sentence for a path that is not a regular file, and for errors while it is read."""
    try:
        if not path.is_file():
            why = "not a file (a pipe, a device or a folder)" if path.exists() else "no such file; check the path"
            raise DataError(path, why)
        yield
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error}); check its permissions") from error
    except DAMAGE as error:
        raise DataError(path, f"damaged or truncated ({first_line(error)}); copy it again") from error


def known(values: npt.NDArray[Any]) -> tuple[Flow, Mask]:
    with np.errstate(over="ignore"):
        flow = np.array(values, np.float32, order="C")
    valid = np.asarray((np.abs(flow) <= UNKNOWN_THRESHOLD).all(axis=2))
    flow[~valid] = 0
    return flow, valid


def checked(path: Path, flow: npt.ArrayLike, valid: npt.ArrayLike | None) -> tuple[Flow, Mask]:
    """Return the arrays to be written, float32 (H, W, 2) and bool (H, W); pixels with non-finite flow are marked
    unknown.
    """
    array = np.asarray(unmasked(flow))
    if array.ndim != 3 or array.shape[2] != 2 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise DataError(path, f"cannot write {array.dtype} {array.shape} as flow; pass numbers of shape (H, W, 2)")
    if max(array.shape[:2]) > MAX_SIDE:
        raise DataError(path, f"a flow of {array.shape[0]}x{array.shape[1]} exceeds {MAX_SIDE} pixels per side")
    mask = np.ones(array.shape[:2], bool) if valid is None else np.asarray(valid)
    if mask.shape != array.shape[:2] or mask.dtype != np.bool_:
        raise DataError(path, f"valid is {mask.dtype} {mask.shape}; pass bool {array.shape[:2]} to match the flow")
    mask = mask & np.isfinite(array).all(axis=2)
    with np.errstate(over="ignore"):
        values = np.where(mask[..., None], array, 0).astype(np.float32)
    if (np.abs(values) > UNKNOWN_THRESHOLD).any():
        raise DataError(path, "a known component exceeds 1e9 and would be read as unknown; mark the pixel invalid")
    return values, mask


def claimed_size(path: Path, width: int, height: int) -> None:
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise DataError(path, f"the header claims {height}x{width} pixels, so the file is damaged; download it again")
    if width * height > MAX_PIXELS:
        raise DataError(path, f"{height}x{width} pixels exceed the limit of {MAX_PIXELS}; split the flow into parts")


def exact_size(path: Path, expected: int, size: int, width: int, height: int) -> None:
    if size != expected:
        state = "truncated" if size < expected else "too long"
        raise DataError(path, f"{state}: {size} bytes, but {height}x{width} pixels need {expected}; copy it again")


_HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+([+-]?1(?:\.0*)?)[ \t]*\r?\n")
_CHANNELS = {b"PF": 3, b"Pf": 1}


def read_pfm(path: Path) -> tuple[Flow, Mask]:
    return known(read_float_map(path, 3)[..., :2])


def read_float_map(path: Path, channels: int) -> npt.NDArray[np.float32]:
    """Read a portable float map, float32 (H, W, channels) in the file's byte order, rows from top to bottom."""
    with open(path, "rb") as file:
        header = _HEADER.match(file.read(128))
        if header is None:
            raise DataError(path, "not a .pfm file with the header 'PF' or 'Pf' and the scale 1 or -1, or truncated")
        if _CHANNELS[header[1]] != channels:
            raise DataError(path, f"has {4 - channels} channel(s) instead of {channels} (1 for depth, 3 for flow)")
        width, height = int(header[2]), int(header[3])
        claimed_size(path, width, height)
        exact_size(path, header.end() + 4 * channels * width * height, path.stat().st_size, width, height)
        file.seek(header.end())
        values = np.fromfile(file, "<f4" if header[4].startswith(b"-") else ">f4")
    return values.reshape(height, width, channels)[::-1]


def read_npy(path: Path, what: str, channels: tuple[int, ...] = ()) -> npt.NDArray[Any]:
    """Read an .npy file with an array of real numbers, (H, W, *channels) or, as PyTorch stores it, (*channels, H, W);
    `what` names the expected content in errors. Returns (H, W, *channels).
    """
    with readable(path):
        stored = np.lib.format.open_memmap(path, mode="r")  # refuses pickled objects, and files that are too short
        shape, dtype = stored.shape, stored.dtype
        first = len(shape) == 3 and shape[:1] == channels != shape[2:]
        kinds = "fi" if channels else "fiu"  # the components of a vector have a sign
        if len(shape) != 2 + len(channels) or not (first or shape[2:] == channels) or dtype.kind not in kinds:
            expected = ", ".join(("H", "W", *map(str, channels)))
            raise DataError(path, f"{dtype} {shape} is not {what}; expected real numbers of shape ({expected})")
        height, width = shape[first:][:2]
        claimed_size(path, width, height)
        exact_size(path, stored.offset + stored.nbytes, path.stat().st_size, width, height)
        return np.array(np.moveaxis(stored, 0, -1) if first else stored, order="C")


def pfm_bytes(flow: Flow, valid: Mask) -> bytes:
    height, width = valid.shape
    values = np.zeros((height, width, 3), "<f4")
    values[..., :2] = np.where(valid[..., None], flow, np.nan)
    return b"PF\n%d %d\n-1.0\n" % (width, height) + values[::-1].tobytes()


def npy_bytes(flow: Flow, valid: Mask) -> bytes:
    file = io.BytesIO()
    np.save(file, np.where(valid[..., None], flow, np.float32(np.nan)), allow_pickle=False)
    return file.getvalue()

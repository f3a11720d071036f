"""Functions shared by all flow formats: detect unknown values, and check sizes and the arrays to write."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ..errors import DataError, first_line
from ..sample import Flow, Mask

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
    if not path.is_file():
        why = "not a file (a pipe, a device or a folder)" if path.exists() else "no such file; check the path"
        raise DataError(f"{path}: {why}")
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error}); check its permissions") from error
    except DAMAGE as error:
        raise DataError(f"{path}: damaged or truncated ({first_line(error)}); copy it again") from error


def known(values: npt.NDArray[Any]) -> tuple[Flow, Mask]:
    """Split raw components (H, W, 2) into float32 flow and bool valid."""
    with np.errstate(over="ignore"):
        flow = np.array(values, np.float32, order="C")
    valid = np.asarray((np.abs(flow) <= UNKNOWN_THRESHOLD).all(axis=2))
    flow[~valid] = 0
    return flow, valid


def checked(path: Path, flow: npt.ArrayLike, valid: npt.ArrayLike | None) -> tuple[Flow, Mask]:
    """Return the arrays to be written, float32 (H, W, 2) and bool (H, W); pixels with non-finite flow are marked
    unknown.
    """
    array = np.asarray(flow)
    if array.ndim != 3 or array.shape[2] != 2 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise DataError(f"{path}: cannot write {array.dtype} {array.shape} as flow; pass numbers of shape (H, W, 2)")
    if max(array.shape[:2]) > MAX_SIDE:
        raise DataError(f"{path}: a flow of {array.shape[0]}x{array.shape[1]} exceeds {MAX_SIDE} pixels per side")
    mask = np.ones(array.shape[:2], bool) if valid is None else np.asarray(valid)
    if mask.shape != array.shape[:2] or mask.dtype != np.bool_:
        raise DataError(f"{path}: valid is {mask.dtype} {mask.shape}; pass bool {array.shape[:2]} to match the flow")
    mask = mask & np.isfinite(array).all(axis=2)
    if (np.abs(array[mask]) > UNKNOWN_THRESHOLD).any():
        raise DataError(f"{path}: a known component exceeds 1e9 and would be read as unknown; mark the pixel invalid")
    return np.where(mask[..., None], array, 0).astype(np.float32), mask


def claimed_size(path: Path, width: int, height: int) -> None:
    """Reject implausible dimensions before memory is allocated."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise DataError(f"{path}: the header claims {height}x{width} pixels, so the file is damaged; download it again")
    if width * height > MAX_PIXELS:
        raise DataError(f"{path}: {height}x{width} pixels exceed the limit of {MAX_PIXELS}; split the flow into parts")


def exact_size(path: Path, expected: int, size: int, width: int, height: int) -> None:
    """Reject a file whose length does not match its header."""
    if size != expected:
        state = "truncated" if size < expected else "too long"
        raise DataError(f"{path}: {state}: {size} bytes, but {height}x{width} pixels need {expected}; copy it again")

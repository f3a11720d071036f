"""Read and write optical flow: Middlebury .flo, KITTI 16-bit .png, .pfm, Spring .flo5."""

from __future__ import annotations

from pathlib import Path

import numpy.typing as npt

from .. import atomic
from ..errors import DataError
from ..sample import Flow, Mask
from .arrays import checked
from .flo import flo_bytes, read_flo
from .flo5 import flo5_bytes, read_flo5
from .kitti import kitti_bytes, read_kitti
from .pfm import pfm_bytes, read_pfm

__all__ = ["FLOW_SUFFIXES", "read_flow", "write_flow"]

FLOW_SUFFIXES = (".flo", ".png", ".pfm", ".flo5")
"""The formats, by the ending of the file name."""

_READERS = {".flo": read_flo, ".png": read_kitti, ".pfm": read_pfm, ".flo5": read_flo5}


def read_flow(path: str | Path) -> tuple[Flow, Mask]:
    """Read a flow file; the ending of its name gives the format (.flo, .png, .pfm, .flo5).

    Returns:
        flow: float32 (H, W, 2), (u right, v down) in pixels, 0 where unknown.
        valid: bool (H, W), False where the file marks the flow as unknown: third channel 0 (.png), a
            component beyond 1e9 (.flo, .pfm, .flo5), NaN or infinite (any).

    Raises:
        DataError: no such file, damaged, cut short, not a flow file, or of an unknown format.
        AssetError: a .flo5 file, and h5py is not installed.

    >>> import numpy as np
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "flow.png"
    >>> write_flow(path, np.full((2, 3, 2), 0.51))
    >>> flow, valid = read_flow(path)
    >>> float(flow[0, 0, 0]), bool(valid.all())
    (0.515625, True)
    """
    path = Path(path)
    reader = _READERS[_suffix(path)]
    if not path.is_file():
        raise DataError(f"{path}: no such flow file; check the path")
    try:
        return reader(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error}); check its permissions") from error


def write_flow(path: str | Path, flow: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> None:
    """Write a flow file atomically; the ending of its name gives the format.

    Args:
        path: ends in .flo, .png (KITTI: rounded to 1/64, from -512 to 511.984375), .pfm or .flo5.
        flow: (H, W, 2) numbers, in pixels.
        valid: bool (H, W); pixels outside it, and pixels with NaN or infinite flow, are written as unknown.

    Raises:
        DataError: wrong shapes, values the format cannot hold, or a file that cannot be written.
        AssetError: a .flo5 file, and h5py is not installed.
    """
    path = Path(path)
    suffix = _suffix(path)
    values, mask = checked(path, flow, valid)
    if suffix == ".flo":
        data = flo_bytes(values, mask)
    elif suffix == ".png":
        data = kitti_bytes(path, values, mask)
    elif suffix == ".pfm":
        data = pfm_bytes(values, mask)
    else:
        data = flo5_bytes(values, mask)
    atomic.write_bytes(path, data)


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FLOW_SUFFIXES:
        raise DataError(f"{path}: unknown flow format '{suffix}'; known: {', '.join(FLOW_SUFFIXES)}")
    return suffix

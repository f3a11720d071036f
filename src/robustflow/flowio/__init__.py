"""Read and write optical flow: Middlebury .flo, KITTI 16-bit .png, .pfm, Spring .flo5."""

from __future__ import annotations

from pathlib import Path

import numpy.typing as npt

from .. import atomic
from ..errors import DataError
from ..sample import Flow, Mask
from .arrays import checked, readable
from .flo import flo_bytes, read_flo
from .flo5 import flo5_bytes, read_flo5
from .kitti import kitti_bytes, read_kitti
from .pfm import pfm_bytes, read_pfm

__all__ = ["FLOW_SUFFIXES", "read_flow", "write_flow"]

FLOW_SUFFIXES = (".flo", ".png", ".pfm", ".flo5")
"""The formats by file extension."""

_READERS = {".flo": read_flo, ".png": read_kitti, ".pfm": read_pfm, ".flo5": read_flo5}


def read_flow(path: str | Path) -> tuple[Flow, Mask]:
    """Read a flow file; the file extension determines the format (.flo, .png, .pfm, .flo5).

    Returns:
        flow: flow vectors (u right, v down), float32 (H, W, 2), in pixels, 0 where unknown.
        valid: boolean mask (H, W), False where the file marks the flow as unknown: a third channel of 0 (.png), a
            component beyond 1e9 in magnitude (.flo, .pfm, .flo5), or NaN or infinity (any format).

    Raises:
        DataError: the file does not exist, is damaged or truncated, is not a flow file, or is of an unknown format.
        AssetError: the file is a .flo5 file, but h5py is not installed.

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
    with readable(path):
        return reader(path)


def write_flow(path: str | Path, flow: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> None:
    """Write a flow file atomically; the file extension determines the format.

    Args:
        path: path of the file, with the extension .flo, .png (KITTI: rounded to 1/64 pixel, range -512 to 511.984375),
            .pfm or .flo5.
        flow: flow vectors, any numeric dtype, (H, W, 2), in pixels.
        valid: boolean mask (H, W); pixels where it is False, and pixels with NaN or infinite flow, are written as
            unknown.

    Raises:
        DataError: a shape is wrong, the format cannot represent a value, or the file cannot be written.
        AssetError: the file is a .flo5 file, but h5py is not installed.
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

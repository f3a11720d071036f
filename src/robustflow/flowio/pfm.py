"""Portable float map with three channels (u, v, unused), the flow format of FlyingThings3D, Monkaa and Driving.

`PF`, width and height, a scale whose sign encodes the byte order (negative: little-endian), then float32 rows from the
bottom to the top of the image. Source: Mayer et al., CVPR 2016, and Debevec's description of the format.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..sample import Flow, Mask
from .arrays import claimed_size, exact_size, known

_HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+([+-]?[0-9][0-9.eE+-]{0,20})[ \t]*\r?\n")
_CHANNELS = {b"PF": 3, b"Pf": 1}


def read_pfm(path: Path) -> tuple[Flow, Mask]:
    """Read a three-channel .pfm file; see `robustflow.flowio.read_flow`."""
    return known(read_float_map(path, 3)[..., :2])


def read_float_map(path: Path, channels: int) -> npt.NDArray[np.float32]:
    """Read a portable float map with one channel (depth or disparity) or three channels (flow), float32 (H, W,
    channels) in the file's byte order; rows from top to bottom.
    """
    with open(path, "rb") as file:
        header = _HEADER.match(file.read(128))
        if header is None:
            raise DataError(f"{path}: not a .pfm file (no 'PF' or 'Pf' header), or truncated; check the file")
        if _CHANNELS[header[1]] != channels:
            kinds = {1: "one channel ('Pf'), as depth and disparity maps have", 3: "three channels ('PF'), as flow has"}
            raise DataError(f"{path}: expected {kinds[channels]}, but the file has {kinds[4 - channels]}")
        width, height = int(header[2]), int(header[3])
        claimed_size(path, width, height)
        scale = _scale_of(path, header[4])
        exact_size(path, header.end() + 4 * channels * width * height, path.stat().st_size, width, height)
        file.seek(header.end())
        values = np.fromfile(file, "<f4" if scale < 0 else ">f4")
    return values.reshape(height, width, channels)[::-1]


def pfm_bytes(flow: Flow, valid: Mask) -> bytes:
    """Return the flow as the bytes of a little-endian .pfm file; unknown pixels are stored as NaN, and the third
    channel is 0.
    """
    height, width = valid.shape
    values = np.zeros((height, width, 3), "<f4")
    values[..., :2] = np.where(valid[..., None], flow, np.nan)
    return b"PF\n%d %d\n-1.0\n" % (width, height) + values[::-1].tobytes()


def _scale_of(path: Path, text: bytes) -> float:
    """Return the scale from a header, 1 or -1; raise a DataError for other values."""
    try:
        scale = float(text)
    except ValueError:
        scale = 0.0
    if abs(scale) != 1.0:
        # Readers disagree on whether to multiply values by the magnitude.
        raise DataError(f"{path}: scale {text.decode()} in the header is not supported; write 1.0 or -1.0")
    return scale

"""Middlebury .flo: `PIEH`, int32 width, int32 height, then float32 (u, v) row by row, all little-endian.

Source: Baker et al., "A Database and Evaluation Methodology for Optical Flow", IJCV 2011, and the authors' flow-code.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..sample import Flow, Mask
from .arrays import claimed_size, exact_size, known

MAGIC = b"PIEH"
UNKNOWN_FLOW = np.float32(1.6666667e9)
"""Value that marks unknown flow in Middlebury's ground truth."""
_HEADER = 12


def read_flo(path: Path) -> tuple[Flow, Mask]:
    """Read a .flo file; see `robustflow.flowio.read_flow`."""
    with open(path, "rb") as file:
        header = file.read(_HEADER)
        if header[:4] != MAGIC[: len(header)] or not header:
            raise DataError(f"{path}: not a Middlebury .flo file (it does not begin with 'PIEH'); check the format")
        if len(header) < _HEADER:
            raise DataError(f"{path}: truncated, only {len(header)} bytes; copy or download it again")
        width, height = struct.unpack("<ii", header[4:])
        claimed_size(path, width, height)
        exact_size(path, _HEADER + 8 * width * height, path.stat().st_size, width, height)
        values = np.fromfile(file, "<f4")
    return known(values.reshape(height, width, 2))


def flo_bytes(flow: Flow, valid: Mask) -> bytes:
    """Return the flow as the bytes of a .flo file; unknown pixels are stored as 1.6666667e9."""
    height, width = valid.shape
    values = np.where(valid[..., None], flow, UNKNOWN_FLOW).astype("<f4")
    return MAGIC + struct.pack("<ii", width, height) + values.tobytes()

"""KITTI flow: a 16-bit RGB PNG with the channels (u * 64 + 2^15, v * 64 + 2^15, valid).

HD1K uses the same format. Source: the development kits of Geiger et al. (2012) and Menze and Geiger (2015).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ..errors import DataError
from ..images.intact import check_png
from ..sample import Flow, Mask
from .arrays import claimed_size

LOWEST, HIGHEST = -512.0, 511.984375
"""Range of the flow in pixels: (0 - 2^15) / 64 to (2^16 - 1 - 2^15) / 64."""


def read_kitti(path: Path) -> tuple[Flow, Mask]:
    """Read a 16-bit PNG; see `robustflow.flowio.read_flow`."""
    raw = read_png16(path, 3, "KITTI flow, which is a 16-bit RGB PNG (u, v, valid)")
    valid = raw[..., 0] > 0
    flow = (raw[..., :0:-1].astype(np.float32) - 32768) / 64
    flow[~valid] = 0
    return np.ascontiguousarray(flow), valid


def read_png16(path: Path, channels: int, what: str) -> npt.NDArray[np.uint16]:
    """Read a 16-bit PNG with one or three channels, uint16 (H, W) or (H, W, 3), in OpenCV's order of channels, blue
    first. Pillow would silently reduce 16-bit RGB to 8 bits.
    """
    data = path.read_bytes()
    header = check_png(path, data)
    claimed_size(path, header.width, header.height)
    if header.bits != 16 or header.channels != channels:
        raise DataError(f"{path}: a {header.bits}-bit PNG with {header.channels} channel(s) is not {what}")
    colour = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED if channels == 1 else colour)
    except cv2.error:
        raw = None
    shape = (header.height, header.width, *([channels] if channels > 1 else []))
    if raw is None or raw.dtype != np.uint16 or raw.shape != shape:
        raise DataError(f"{path}: a damaged PNG that cannot be decoded; copy or download it again")
    return np.asarray(raw)


def kitti_bytes(path: Path, flow: Flow, valid: Mask) -> bytes:
    """Return the flow as the bytes of a KITTI PNG, rounded to 1/64 pixel; unknown pixels are stored as (0, 0, 0)."""
    scaled = np.rint(flow.astype(np.float64) * 64) + 32768
    outside = valid & ((scaled < 0) | (scaled > 65535)).any(axis=2)
    if outside.any():
        worst = np.abs(flow[outside]).max()
        raise DataError(
            f"{path}: {int(outside.sum())} pixels (largest component {worst:.6g}) are outside KITTI's "
            f"{LOWEST:g} to {HIGHEST} pixels; write .flo instead, or mark them invalid"
        )
    raw = np.empty((*valid.shape, 3), np.uint16)
    raw[..., 0] = valid
    raw[..., 2] = np.where(valid, scaled[..., 0], 0)
    raw[..., 1] = np.where(valid, scaled[..., 1], 0)
    encoded, data = cv2.imencode(".png", raw)
    if not encoded:
        raise DataError(f"{path}: OpenCV could not encode {flow.shape[0]}x{flow.shape[1]} pixels as PNG; write .flo")
    return data.tobytes()

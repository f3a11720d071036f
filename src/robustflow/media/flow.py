"""Read and write optical flow: Middlebury .flo, KITTI 16-bit .png, .pfm, Spring .flo5, NumPy .npy.

- .flo: `PIEH`, int32 width, int32 height, then float32 (u, v) row by row, all little-endian. Source: Baker et al., "A
  Database and Evaluation Methodology for Optical Flow", IJCV 2011, and the authors' flow-code.
- .flo5: an HDF5 file with one float dataset "flow" (H, W, 2), NaN where unknown; requires the extra `h5`. Spring stores
  2160x3840 vectors for frames of 1080x1920, in pixels of the frames. Source: Mehl et al., CVPR 2023, and `flow_IO`
  from the benchmark's code.
- .png: 16-bit RGB with the channels (u * 64 + 2^15, v * 64 + 2^15, valid); HD1K uses the same format. Source: the
  development kits of Geiger et al. (2012) and Menze and Geiger (2015). Other datasets use other numbers: a third
  channel that is not 0 or 1 is refused; DSEC's factor, 128, can only be seen from the frames (see `misread`).
- .pfm: see `arrays`.
- .npy: an array (H, W, 2), or (2, H, W) as PyTorch stores it, NaN where unknown.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from ..core import files
from ..core.errors import DataError, first_line
from ..core.plugins import require
from ..core.types import Flow, Mask
from .arrays import checked, claimed_size, exact_size, known, npy_bytes, pfm_bytes, read_npy, read_pfm, readable
from .complete import silent_libraries
from .images import PILLOW_ERRORS

MAGIC = b"PIEH"
UNKNOWN_FLOW = np.float32(1.6666667e9)
"""Value that marks unknown flow in Middlebury's ground truth."""
_HEADER = 12


def read_flo(path: Path) -> tuple[Flow, Mask]:
    with open(path, "rb") as file:
        header = file.read(_HEADER)
        if header[:4] != MAGIC[: len(header)] or not header:
            raise DataError(path, "not a Middlebury .flo file (it does not begin with 'PIEH'); check the format")
        if len(header) < _HEADER:
            raise DataError(path, f"truncated, only {len(header)} bytes; copy or download it again")
        width, height = struct.unpack("<ii", header[4:])
        claimed_size(path, width, height)
        exact_size(path, _HEADER + 8 * width * height, path.stat().st_size, width, height)
        values = np.fromfile(file, "<f4")
    return known(values.reshape(height, width, 2))


def flo_bytes(flow: Flow, valid: Mask) -> bytes:
    height, width = valid.shape
    values = np.where(valid[..., None], flow, UNKNOWN_FLOW).astype("<f4")
    return MAGIC + struct.pack("<ii", width, height) + values.tobytes()


_FILTERS = (1, 2, 3)
"""HDF5's numbers for deflate, shuffle and the Fletcher checksum."""

_MOST_INFLATED = 1100
"""Deflate cannot compress data by more than 1032:1, so a file that claims a higher ratio is damaged."""

_HARMLESS = 2**16
"""Chunks up to this compressed size, in bytes, cannot inflate to more than 72 MB and are not checked."""


def read_flo5(path: Path) -> tuple[Flow, Mask]:
    return known(read_dataset(path, "flow", ".flo5", (2,)))


def read_dataset(path: Path, name: str, kind: str, channels: tuple[int, ...]) -> Any:
    """Read the float dataset `name`, (H, W, *channels), from a Spring file."""
    h5py = _h5py()
    try:
        with h5py.File(path, "r") as file:
            # A link or a virtual dataset could refer to any other file on this machine.
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise DataError(path, f"contains no dataset '{name}', so it is not a Spring {kind} file")
            return _values(h5py, path, file[name], kind, channels)
    except (OSError, RuntimeError, ValueError, KeyError, MemoryError, zlib.error) as error:
        raise DataError(path, f"not a readable HDF5 file ({first_line(error)}); copy or download it again") from error


def flo5_bytes(flow: Flow, valid: Mask) -> bytes:
    buffer = io.BytesIO()
    with _h5py().File(buffer, "w") as file:
        values = np.where(valid[..., None], flow, np.float32(np.nan))
        file.create_dataset("flow", data=values, compression="gzip", compression_opts=5)
    return buffer.getvalue()


def _values(h5py: Any, path: Path, node: Any, kind: str, channels: tuple[int, ...]) -> Any:
    if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external:
        raise DataError(path, f"{node.name[1:]!r} is not stored as a plain dataset in this file; get the original file")
    if len(node.shape) != 2 + len(channels) or node.shape[2:] != channels or node.dtype.kind != "f":
        wanted = ", ".join(("H", "W", *map(str, channels)))
        raise DataError(path, f"{node.name[1:]!r} is {node.dtype} {node.shape}; a Spring {kind} is float ({wanted})")
    claimed_size(path, node.shape[1], node.shape[0])
    needed = node.size * node.dtype.itemsize
    chunk = int(np.prod(node.chunks, dtype=np.int64)) * node.dtype.itemsize if node.chunks else 0
    stored = node.id.get_storage_size()
    if max(needed, chunk) > _MOST_INFLATED * stored:
        raise DataError(path, f"damaged, claims {needed} bytes but stores {stored}; download it again")
    if node.chunks:
        _check_chunks(path, node, chunk)
    return node[()]


def _check_chunks(path: Path, node: Any, size: int) -> None:
    """Reject chunks that inflate to more than `size` bytes; HDF5 would allocate memory for all of it."""
    recipe = node.id.get_create_plist()
    filters = [recipe.get_filter(place)[0] for place in range(recipe.get_nfilters())]
    if len(set(filters)) < len(filters) or not set(filters) <= set(_FILTERS):
        raise DataError(path, f"has HDF5 filters {filters} instead of gzip once; save it again with gzip")
    large: list[tuple[int, ...]] = []
    node.id.chunk_iter(lambda chunk: large.append(chunk.chunk_offset) if chunk.size > _HARMLESS else None)
    for place in large if 1 in filters else ():
        _, data = node.id.read_direct_chunk(place)
        if len(zlib.decompressobj().decompress(data, size + 1)) > size:
            raise DataError(path, f"damaged, a chunk inflates to more than its {size} bytes; download it again")


def _h5py() -> Any:
    require("h5py", "reading and writing .flo5")
    import h5py

    return h5py


LOWEST, HIGHEST = -512.0, 511.984375
"""Range of the flow in pixels: (0 - 2^15) / 64 to (2^16 - 1 - 2^15) / 64."""


def read_kitti(path: Path) -> tuple[Flow, Mask]:
    raw = read_png16(path, 3, "KITTI flow, which is a 16-bit RGB PNG (u, v, valid)")
    if (marks := raw[..., 0]).max() > 1:
        raise DataError(
            path,
            f"its third channel contains {marks.max()}, but KITTI's is 0 or 1: this is a picture, or flow with another "
            "scale, such as Virtual KITTI's u = (2 red / 65535 - 1) (width - 1); convert it, e.g. to .flo or .npy",
        )
    valid = marks > 0
    flow = (raw[..., :0:-1].astype(np.float32) - 32768) / 64
    flow[~valid] = 0
    return np.ascontiguousarray(flow), valid


def read_flow_npy(path: Path) -> tuple[Flow, Mask]:
    return known(read_npy(path, "a flow", (2,)))


def read_png16(path: Path, channels: int, what: str) -> npt.NDArray[np.uint16]:
    """Read a 16-bit PNG with one or three channels, uint16 (H, W) or (H, W, 3), in OpenCV's order of channels, blue
    first. Pillow would silently reduce 16-bit RGB to 8 bits.
    """
    data = path.read_bytes()
    try:
        claimed_size(path, *Image.open(io.BytesIO(data), formats=("PNG",)).size)
    except PILLOW_ERRORS as error:
        raise DataError(path, f"not a PNG, or damaged ({first_line(error)}); copy or download it again") from error
    with silent_libraries():
        raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise DataError(path, "a damaged PNG that cannot be decoded; copy or download it again")
    count = raw.shape[2] if raw.ndim == 3 else 1
    if raw.dtype != np.uint16 or count != channels:
        raise DataError(path, f"a {8 * raw.itemsize}-bit PNG with {count} channel(s) is not {what}")
    return np.asarray(raw, np.uint16)


def kitti_bytes(path: Path, flow: Flow, valid: Mask) -> bytes:
    scaled = np.rint(flow.astype(np.float64) * 64) + 32768
    outside = valid & ((scaled < 0) | (scaled > 65535)).any(axis=2)
    if outside.any():
        worst = np.abs(flow[outside]).max()
        limits = f"{int(outside.sum())} pixels (up to {worst:.6g}) are outside KITTI's {LOWEST:g} to {HIGHEST} pixels"
        raise DataError(path, f"{limits}; write .flo instead, or mark them invalid")
    raw = np.empty((*valid.shape, 3), np.uint16)
    raw[..., 0] = valid
    raw[..., 2] = np.where(valid, scaled[..., 0], 0)
    raw[..., 1] = np.where(valid, scaled[..., 1], 0)
    encoded, data = cv2.imencode(".png", raw)
    if not encoded:
        raise DataError(path, f"OpenCV could not encode {flow.shape[0]}x{flow.shape[1]} pixels as PNG; write .flo")
    return data.tobytes()


__all__ = ["FLOW_SUFFIXES", "read_flow", "write_flow"]

FLOW_SUFFIXES = (".flo", ".png", ".pfm", ".flo5", ".npy")
"""The formats by file extension."""

_READERS = {".flo": read_flo, ".png": read_kitti, ".pfm": read_pfm, ".flo5": read_flo5, ".npy": read_flow_npy}


def read_flow(path: str | Path) -> tuple[Flow, Mask]:
    """Read a flow file; the file extension determines the format (.flo, .png, .pfm, .flo5, .npy).

    Returns:
        flow: flow vectors (u right, v down), float32 (H, W, 2), in pixels, 0 where unknown.
        valid: boolean mask (H, W), False where the file marks the flow as unknown: a third channel of 0 (.png), a
            component beyond 1e9 in magnitude (.flo, .pfm, .flo5, .npy), or NaN or infinity (any format).

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
            .pfm, .flo5 or .npy.
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
    writers = {".flo": flo_bytes, ".pfm": pfm_bytes, ".flo5": flo5_bytes, ".npy": npy_bytes}
    data = kitti_bytes(path, values, mask) if suffix == ".png" else writers[suffix](values, mask)
    files.write_bytes(path, data)


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FLOW_SUFFIXES:
        raise DataError(path, f"unknown flow format '{suffix}'; known: {', '.join(FLOW_SUFFIXES)}")
    return suffix

"""Spring .flo5: an HDF5 file with one float dataset "flow" (H, W, 2), NaN where unknown; requires the extra `h5`.

Spring stores 2160x3840 vectors for frames of 1080x1920, in pixels of the frames; `datasets.spring` uses every second
vector, as the benchmark does. Source: Mehl et al., CVPR 2023, and `flow_IO` from the benchmark's code.
"""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, first_line
from ..extras import require
from ..images.intact import MOST_INFLATED
from ..sample import Flow, Mask
from .arrays import claimed_size, known

_FILTERS = (1, 2, 3)
"""HDF5's numbers for deflate, shuffle and the Fletcher checksum."""

_HARMLESS = 2**16
"""Chunks up to this compressed size, in bytes, cannot inflate to more than 72 MB and are not checked."""


def read_flo5(path: Path) -> tuple[Flow, Mask]:
    """Read a .flo5 file; see `robustflow.flowio.read_flow`."""
    return known(read_dataset(path, "flow", ".flo5", (2,)))


def read_dataset(path: Path, name: str, kind: str, channels: tuple[int, ...]) -> Any:
    """Read the float dataset `name`, (H, W, *channels), from a Spring file."""
    h5py = _h5py()
    try:
        with h5py.File(path, "r") as file:
            # A link or a virtual dataset could refer to any other file on this machine.
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise DataError(
                    f"{path}: contains no dataset '{name}', so it is not a Spring {kind} file; check the file"
                )
            return _values(h5py, path, file[name], kind, channels)
    except (OSError, RuntimeError, ValueError, KeyError, MemoryError, zlib.error) as error:
        raise DataError(f"{path}: not a readable HDF5 file ({first_line(error)}); copy or download it again") from error


def flo5_bytes(flow: Flow, valid: Mask) -> bytes:
    """Return the flow as the bytes of a compressed .flo5 file; unknown pixels are stored as NaN."""
    buffer = io.BytesIO()
    with _h5py().File(buffer, "w") as file:
        values = np.where(valid[..., None], flow, np.float32(np.nan))
        file.create_dataset("flow", data=values, compression="gzip", compression_opts=5)
    return buffer.getvalue()


def _values(h5py: Any, path: Path, node: Any, kind: str, channels: tuple[int, ...]) -> Any:
    if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external:
        raise DataError(
            f"{path}: {node.name[1:]!r} is not stored as a plain dataset in this file; get the original file"
        )
    if len(node.shape) != 2 + len(channels) or node.shape[2:] != channels or node.dtype.kind != "f":
        wanted = ", ".join(("H", "W", *map(str, channels)))
        raise DataError(f"{path}: {node.name[1:]!r} is {node.dtype} {node.shape}; a Spring {kind} is float ({wanted})")
    claimed_size(path, node.shape[1], node.shape[0])
    needed = node.size * node.dtype.itemsize
    chunk = int(np.prod(node.chunks, dtype=np.int64)) * node.dtype.itemsize if node.chunks else 0
    stored = node.id.get_storage_size()
    if max(needed, chunk) > MOST_INFLATED * stored:
        raise DataError(f"{path}: damaged, claims {needed} bytes but stores {stored}; download it again")
    if node.chunks:
        _check_chunks(path, node, chunk)
    return node[()]


def _check_chunks(path: Path, node: Any, size: int) -> None:
    """Reject chunks that inflate to more than `size` bytes; HDF5 would allocate memory for all of it."""
    recipe = node.id.get_create_plist()
    filters = [recipe.get_filter(place)[0] for place in range(recipe.get_nfilters())]
    if len(set(filters)) < len(filters) or not set(filters) <= set(_FILTERS):
        raise DataError(f"{path}: has HDF5 filters {filters} instead of gzip once; save it again with gzip")
    large: list[tuple[int, ...]] = []
    node.id.chunk_iter(lambda chunk: large.append(chunk.chunk_offset) if chunk.size > _HARMLESS else None)
    for place in large if 1 in filters else ():
        _, data = node.id.read_direct_chunk(place)
        if len(zlib.decompressobj().decompress(data, size + 1)) > size:
            raise DataError(f"{path}: damaged, a chunk inflates to more than its {size} bytes; download it again")


def _h5py() -> Any:
    require("h5py", "reading and writing .flo5")
    import h5py

    return h5py

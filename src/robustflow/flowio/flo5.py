"""Spring .flo5: an HDF5 file with one float dataset "flow" (H, W, 2), NaN where unknown; needs extra `h5`.

Spring stores 3840x2160 vectors for frames of 1920x1080, in pixels of the frames; `datasets.spring` takes
every second one, as the benchmark does. Source: Mehl et al., CVPR 2023, flow_IO of the benchmark.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, first_line
from ..extras import require
from ..sample import Flow, Mask
from .arrays import claimed_size, known

_INFLATE = 1100
"""Deflate cannot shrink data by more than 1032:1; a file that claims more holds no such data."""


def read_flo5(path: Path) -> tuple[Flow, Mask]:
    """Read a .flo5 file; see `robustflow.flowio.read_flow`."""
    h5py = _h5py()
    try:
        with h5py.File(path, "r") as file:
            # A link or virtual dataset could point at any other file of this machine.
            if not isinstance(file.get("flow", getlink=True), h5py.HardLink):
                raise DataError(f"{path}: no dataset 'flow' inside, so not a Spring .flo5 file; check the file")
            values = _values(h5py, path, file["flow"])
    except (OSError, RuntimeError, ValueError, KeyError, MemoryError) as error:
        raise DataError(f"{path}: not a readable HDF5 file ({first_line(error)}); copy or download it again") from error
    return known(values)


def flo5_bytes(flow: Flow, valid: Mask) -> bytes:
    """The contents of a .flo5 file, compressed; unknown pixels become NaN."""
    buffer = io.BytesIO()
    with _h5py().File(buffer, "w") as file:
        values = np.where(valid[..., None], flow, np.float32(np.nan))
        file.create_dataset("flow", data=values, compression="gzip", compression_opts=5)
    return buffer.getvalue()


def _values(h5py: Any, path: Path, node: Any) -> Any:
    if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external:
        raise DataError(f"{path}: 'flow' is not a plain dataset of this file; refused, get the original file")
    if len(node.shape) != 3 or node.shape[2] != 2 or node.dtype.kind != "f":
        raise DataError(f"{path}: 'flow' is {node.dtype} {node.shape}; a Spring .flo5 holds float (H, W, 2)")
    claimed_size(path, node.shape[1], node.shape[0])
    needed = node.size * node.dtype.itemsize
    chunk = int(np.prod(node.chunks, dtype=np.int64)) * node.dtype.itemsize if node.chunks else 0
    stored = node.id.get_storage_size()
    if max(needed, chunk) > _INFLATE * stored:
        raise DataError(f"{path}: damaged, claims {needed} bytes of flow and stores {stored}; get the file again")
    return node[()]


def _h5py() -> Any:
    require("h5py", "reading and writing .flo5")
    import h5py

    return h5py

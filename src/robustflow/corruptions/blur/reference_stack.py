"""Read the reference code's PSF stacks from files provided by the user; each file is converted once.

The reference code has one `.pth` file per severity, with a float32 tensor (64, 3, 61, 61). The files are named after
the lenses ("piece_1_fov34.0_fnum3.8_aper0_rms0.0832_idx2.pth"). The reference code correlates images with these arrays;
for convolution, they are rotated by 180 degrees.
"""

from __future__ import annotations

import hashlib
import io
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...atomic import make_folder, write_bytes
from ...cache import cache_folder
from ...errors import AssetError, DataError
from ...extras import require
from ...pickle_scan import scan_torch_file
from ...psf.psf_field import SHAPE, PsfField
from ...sealed import sealed_bytes, unsealed_bytes

LARGEST = 16 * 2**20
"""Maximum file size in bytes; the size of a stack is 2.9 million bytes."""


def find_stack(folder: Path, rms: float) -> Path:
    """Return the only `.pth` file in a folder whose name contains the RMS radius `rms` (mm, as in the paper)."""
    if not folder.is_dir():
        raise AssetError(
            f"the PSF folder {folder} does not exist; specify the folder with the reference code's .pth files"
        )
    files = sorted(folder.glob(f"*rms{rms:.4f}*.pth"))
    if len(files) != 1:
        raise AssetError(
            f"{folder} contains {len(files)} files named *rms{rms:.4f}*.pth, expected one; "
            "specify the folder with the reference code's five PSF stacks"
        )
    return files[0]


def reference_field(folder: str | Path, rms: float) -> PsfField:
    """Load the PSFs of the reference lens with RMS radius `rms` from a folder of `.pth` files."""
    path = find_stack(Path(folder), rms)
    try:
        size = path.stat().st_size
        if size > LARGEST:
            raise DataError(f"{path} is not a PSF stack: it has {size} bytes instead of 2.9 million")
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"cannot read the PSF stack {path}: {error.strerror}") from error
    source = hashlib.sha256(data).hexdigest()
    cached = cache_folder("psf") / f"{source}.stack"
    stack = _read_kept(cached, source)
    if stack is None:
        stack = _read_tensor(path, data)
        make_folder(cached.parent)
        write_bytes(cached, sealed_bytes(stack.tobytes(), source))
    try:
        return PsfField(stack[:, :, ::-1, ::-1])
    except DataError as error:
        raise DataError(f"{path}: {error}; use an unmodified .pth file") from error


def _read_kept(path: Path, source: str) -> npt.NDArray[np.float32] | None:
    """Return a converted stack from the cache, or None if it is missing or damaged."""
    try:
        with open(path, "rb") as file:
            values = unsealed_bytes(file.read(LARGEST), source)
    except OSError:
        return None
    if values is None or len(values) != 4 * math.prod(SHAPE):
        return None
    return np.frombuffer(values, np.float32).reshape(SHAPE)


def _read_tensor(path: Path, data: bytes) -> npt.NDArray[np.float32]:
    require("torch", f"reading {path} for the first time")
    import torch

    try:
        scan_torch_file(io.BytesIO(data))
        tensor = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a different exception type for each kind of invalid file
        raise DataError(f"{path} is not a PSF stack that can be read safely; use an unmodified .pth file") from error
    if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != SHAPE or tensor.dtype != torch.float32:
        raise DataError(f"{path} is not a single float32 tensor of shape {SHAPE}; use an unmodified .pth file")
    return np.asarray(tensor.numpy(), np.float32)

"""PSF stacks of the reference code, where a user has them: read safely, converted once.

The reference code keeps one `.pth` file per severity, a float32 tensor (64, 3, 61, 61), named after its lens
("piece_1_fov34.0_fnum3.8_aper0_rms0.0832_idx2.pth"). It correlates images with these arrays; a convolution needs
them turned by half a turn.
"""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..atomic import make_folder, write_bytes
from ..errors import AssetError, DataError
from .psf_field import SHAPE, PsfField

LARGEST = 16 * 2**20
"""Bytes; a stack has 2.9 million, anything much larger is not one."""


def cache_folder() -> Path:
    """Where converted stacks are kept: `ROBUSTFLOW_CACHE`, else the user's cache folder."""
    root = os.environ.get("ROBUSTFLOW_CACHE")
    if root:
        return Path(root) / "psf"
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "robustflow" / "psf"


def find_stack(folder: Path, rms: float) -> Path:
    """The one `.pth` file of a folder whose name says `rms` (mm, as in the paper).

    Raises:
        AssetError: no folder, no such file, or several.
    """
    if not folder.is_dir():
        raise AssetError(f"the PSF folder {folder} does not exist; give the folder with the reference's .pth files")
    found = sorted(folder.glob(f"*rms{rms:.4f}*.pth"))
    if len(found) != 1:
        raise AssetError(
            f"{folder} holds {len(found)} files named *rms{rms:.4f}*.pth, one is needed; "
            "give the folder with the five PSF stacks of the reference code"
        )
    return found[0]


def reference_field(folder: str | Path, rms: float) -> PsfField:
    """The PSFs of the reference lens of RMS radius `rms` from a folder of `.pth` files.

    The file is read by torch with `weights_only`, once: the result is kept in `cache_folder()` under the SHA-256 of
    the file, and read from there without torch afterwards.

    Raises:
        AssetError: the file is missing, or torch is needed and not installed.
        DataError: the file is not a stack.
    """
    path = find_stack(Path(folder), rms)
    if path.stat().st_size > LARGEST:
        raise DataError(f"{path} has {path.stat().st_size} bytes, a PSF stack has 2.9 million; wrong file")
    data = path.read_bytes()
    kept = cache_folder() / f"{hashlib.sha256(data).hexdigest()}.npy"
    if kept.exists():
        try:
            return PsfField(np.load(kept, allow_pickle=False)[:, :, ::-1, ::-1])
        except (OSError, EOFError, ValueError, DataError):
            kept.unlink(missing_ok=True)  # damaged: convert the file again
    stack = _read_tensor(path, data)
    field = PsfField(stack[:, :, ::-1, ::-1])
    buffer = io.BytesIO()
    np.save(buffer, stack, allow_pickle=False)
    make_folder(kept.parent)
    write_bytes(kept, buffer.getvalue())
    return field


def _read_tensor(path: Path, data: bytes) -> npt.NDArray[np.float32]:
    try:
        import torch
    except ImportError as error:
        raise AssetError(
            f"reading {path} for the first time needs torch; install it with: pip install 'robustflow[torch]'"
        ) from error
    try:
        tensor = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a different type for each way in which a file can be wrong
        raise DataError(f"{path} is not a PSF stack that can be read safely; give an unchanged .pth file") from error
    if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != SHAPE or tensor.dtype != torch.float32:
        raise DataError(f"{path} does not hold one float32 tensor of shape {SHAPE}; give an unchanged .pth file")
    return np.asarray(tensor.numpy(), np.float32)

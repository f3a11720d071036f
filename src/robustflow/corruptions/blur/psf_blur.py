"""Blur like a low-quality lens, whose PSF varies from the image centre to the corners.

The reference code's PSF stacks can be used instead of the shipped lenses: one `.pth` file per severity with a float32
tensor (64, 3, 61, 61), named after the lens ("piece_1_fov34.0_fnum3.8_aper0_rms0.0832_idx2.pth"). Each file is
converted once. The reference code correlates images with these arrays; for convolution, they are rotated by half a
turn.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.errors import AssetError, DataError, UsageError
from ...core.files import cache_folder, make_folder, read_bounded, sealed_bytes, unsealed_bytes, write_bytes
from ...core.paths import user_path
from ...core.pickle_scan import scan_torch_file
from ...core.plugins import require
from ...core.types import Frame
from ..base import Corruption
from ..optics.blur import blur
from ..optics.psf_field import SHAPE, PsfField, shipped_field

LARGEST = 16 * 2**20
"""Maximum file size in bytes; the size of a stack is 2.9 million bytes."""


def reference_field(folder: str | Path, rms: float) -> PsfField:
    """Load the PSFs of the reference lens with RMS radius `rms` from a folder of `.pth` files."""
    files = sorted(Path(folder).glob(f"*rms{rms:.4f}*.pth"))
    if len(files) != 1:
        raise AssetError(
            folder,
            f"contains {len(files)} files named *rms{rms:.4f}*.pth, expected one; specify the folder with the "
            "reference code's five PSF stacks",
        )
    path = files[0]
    data = read_bounded(path, LARGEST, "a PSF stack has 2.9 million bytes")
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
        raise DataError(path, f"{error}; use an unmodified .pth file") from error


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
        raise DataError(path, "not a PSF stack that can be read safely; use an unmodified .pth file") from error
    if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != SHAPE or tensor.dtype != torch.float32:
        raise DataError(path, f"not a single float32 tensor of shape {SHAPE}; use an unmodified .pth file")
    return np.asarray(tensor.numpy(), np.float32)


PSF_DIR = "ROBUSTFLOW_PSF_DIR"
"""Environment variable for the folder with the reference code's PSF stacks, used if `psf_dir` is None."""

_WHOLE = np.float32(1e-3)
"""Tolerance in grey levels for rounding errors that push a result of `blur` just below an integer; ten times the
maximum error.
"""


class PsfBlur(Corruption):
    """Applies the spatially varying blur of one of five lenses (paper, Sec. 3 and appendix, PSF blur).

    The severity parameter is the RMS radius of the paper's lens in mm. The lenses are part of this package (`robustflow
    optics`) and designed to produce the same amount of blur as those in the paper, although their RMS radii are 4 to
    8 % smaller (`optics.psf_field.RMS_RADII`); set `psf_dir` to load the paper's lenses from the reference code's
    files. Both frames are blurred identically, nothing is random, and the PSFs are
    centred so that the blur does not shift the image.

    `variant="reference"` truncates grey levels, as the reference code does; otherwise they are rounded. The reference
    code leaves the last H % 16 rows and W % 16 columns black, and also a central tile if both tile counts are odd; no
    variant reproduces this.

    >>> import numpy as np
    >>> grey = np.full((40, 60, 3), 90, np.uint8)
    >>> bool((PsfBlur().apply(grey, 0.1939, 0) == 90).all())
    True
    """

    name = "psf_blur"
    family = "blur"
    source_key = "psf"
    paper_severities = (0.0296, 0.0832, 0.1102, 0.1588, 0.1939)

    def __init__(
        self, variant: str = "default", severities: tuple[Any, ...] | None = None, psf_dir: str | Path | None = None
    ) -> None:
        super().__init__(variant, severities)
        chosen = psf_dir if psf_dir is not None else os.environ.get(PSF_DIR)
        self.psf_dir = user_path(chosen) if chosen else None
        for rms in self.severities:
            if rms is not None and rms not in self.paper_severities:
                known = ", ".join(str(value) for value in self.paper_severities)
                raise UsageError(self.name, f"no lens has an RMS radius of {rms} mm; choose from {known}")

    def field(self, rms: float) -> PsfField:
        """Return the PSFs of the lens for a severity parameter."""
        if self.psf_dir is not None:
            return _reference(self.psf_dir, rms)
        return shipped_field(self.paper_severities.index(rms) + 1)

    @property
    def source(self) -> str:
        if self.psf_dir is None:
            return ""
        return "reference " + " ".join(self.field(rms).digest[:12] for rms in self.paper_severities)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        blurred = blur(frame, self.field(state))
        if self.variant == "reference":
            np.floor(blurred + _WHOLE, out=blurred)
        return np.clip(np.rint(blurred), 0.0, 255.0).astype(np.uint8, order="C")


@lru_cache(maxsize=5)
def _reference(folder: Path, rms: float) -> PsfField:
    return reference_field(folder, rms)

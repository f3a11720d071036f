"""The "blur" family of corruptions: Gaussian, defocus, glass, camera motion and lens blur (paper, appendix, blur)."""

from __future__ import annotations

import io
import os
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.compiled import njit
from ..core.errors import AssetError, DataError, UsageError
from ..core.files import read_bounded
from ..core.paths import user_path
from ..core.plugins import require
from ..core.rng import Rng, hash64
from ..core.types import Frame
from ..media.tensor_file import load_tensors
from .corruption import Corruption
from .kernels.disk import convolve_disk
from .kernels.filters import FLOOR, gaussian_frame
from .kernels.line_motion import LineKernel, line_kernel, move_frame
from .optics.blur import blur
from .optics.psf_field import SHAPE, PsfField, shipped_field


class GaussianBlur(Corruption):
    """Applies a Gaussian filter to both frames (paper, appendix "Corruption Details", blur).

    The severity parameter is the standard deviation in pixels. As in the reference code, edge pixels are repeated
    beyond the border, and the kernel is cut off at four standard deviations. `variant="reference"` truncates the result
    instead of rounding it.

    >>> GaussianBlur().parameter(5)
    6.0
    """

    name = "gaussian_blur"
    paper_severities = (1.0, 2.0, 3.0, 4.0, 6.0)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        return gaussian_frame(frame, state, FLOOR if self.variant == "reference" else 0.0)


class Disk(NamedTuple):
    radius: float  # radius of the disk, in pixels
    smoothing: float  # standard deviation of the anti-aliasing, in pixels


class DefocusBlur(Corruption):
    """Convolves both frames with an anti-aliased disk (paper, appendix "Corruption Details", blur).

    The severity parameters are (radius in pixels, standard deviation of the anti-aliasing). The paper describes a
    "circular mean filter". The reference code smooths a disk inside an array that is too small for the radii 8 and 10
    and mirrors the disk at the edge of the array, so these kernels sum to 1.013 and 1.011 and brighten the image. This
    behaviour is kept because it is part of the published results. Borders mirror the image without repeating the edge
    pixel. `variant="paper"` uses the disk without anti-aliasing; `variant="reference"` truncates instead of rounding.
    """

    name = "defocus_blur"
    level = Disk
    paper_severities = ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, float]:
        disk: Disk = self.parameter(severity)
        return float(disk.radius), 0.0 if self.variant == "paper" else float(disk.smoothing)

    def apply(self, frame: Frame, state: tuple[float, float], index: int) -> Frame:
        return convolve_disk(frame, *state, floor=self.variant == "reference")


class Shake(NamedTuple):
    radius: int  # radius alpha in pixels; the kernel has 2 * radius + 1 taps
    sigma: float  # standard deviation of the tap weights, in pixels


class CameraMotionBlur(Corruption):
    """Smears both frames in one direction, like camera shake (paper, appendix, blur).

    The severity parameters are (radius alpha, standard deviation sigma) in pixels. The kernel has 2 * alpha + 1 taps
    along a line, weighted by one half of a Gaussian that starts at the pixel itself, so it also shifts the content of
    both frames equally, by 2.2 to 11.5 px on average depending on the severity. The direction is uniformly distributed
    within +-45 degrees of the horizontal and shared by both frames. Edge pixels are repeated beyond the border. In
    small images, the reference code drops the taps outside the image, which darkens the result; this implementation
    does not.
    """

    name = "camera_motion_blur"
    temporal = True
    level = Shake
    paper_severities = ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> LineKernel:
        shake: Shake = self.parameter(severity)
        return line_kernel(shake.radius, shake.sigma, rng.uniform(-45.0, 45.0))

    def apply(self, frame: Frame, state: LineKernel, index: int) -> Frame:
        return move_frame(frame, state)


SourceIndex = npt.NDArray[np.int32]
"""Flat source index of each pixel, int32 (H, W)."""


class Glass(NamedTuple):
    sigma: float  # standard deviation of both blurs, in pixels
    reach: int  # maximum distance alpha between swapped pixels, in pixels
    iterations: int  # number of shuffle passes beta


class GlassBlur(Corruption):
    """Applies a Gaussian blur, a local shuffle shared by both frames, and a second Gaussian blur (paper, appendix,
    blur).

    The severity parameters are (sigma, neighbourhood alpha, iterations beta). The shuffle proceeds from the bottom
    right to the top left and pairs each pixel with a random partner, whose offset is between -alpha and alpha - 1 in
    both directions. According to the paper, the two pixels are swapped. In the reference code, however, array views
    turn the swap into a copy: the pixel is set to its partner's value, and the partner is unchanged. Some values
    therefore disappear, and the content drifts by up to 3 px, equally in both frames. This is the default because it
    is part of the published results; `variant="paper"` swaps the pixels. The first blur truncates its result, as in
    the reference code.
    """

    name = "glass_blur"
    level = Glass
    paper_severities = ((0.7, 1, 2), (0.9, 2, 1), (1.0, 2, 3), (1.1, 3, 2), (1.5, 4, 2))

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> tuple[float, SourceIndex]:
        glass: Glass = self.parameter(severity)
        return float(glass.sigma), draw_shuffle(rng, shape, glass.reach, glass.iterations, swap=self.variant == "paper")

    def apply(self, frame: Frame, state: tuple[float, SourceIndex], index: int) -> Frame:
        sigma, source = state
        blurred = gaussian_frame(frame, sigma, FLOOR)
        shuffled = np.empty_like(blurred)
        _gather(blurred.reshape(-1, 3), source.reshape(-1), shuffled.reshape(-1, 3))
        return gaussian_frame(shuffled, sigma)


def draw_shuffle(rng: Rng, shape: tuple[int, int], reach: int, iterations: int, swap: bool) -> SourceIndex:
    """Shuffle the pixel indices of an image of `shape` (H, W)."""
    height, width = shape
    source = np.arange(height * width, dtype=np.int32)
    steps = np.arange(-reach, reach)
    offsets = (steps[:, None] * width + steps[None, :]).ravel().astype(np.int64)
    for iteration in range(iterations):
        key = np.uint64(rng.spawn("shuffle", iteration).key)
        _shuffle(key, source, height, width, reach, offsets, swap)
    return source.reshape(shape)


@njit(cache=True, nogil=True)
def _shuffle(key: Any, source: Any, height: int, width: int, reach: int, offsets: Any, swap: bool) -> None:
    """Run one shuffle pass; 16 bits of a hash select one of at most 64 offsets, with a bias below 1e-3."""
    count = np.uint64(offsets.size)
    bits = np.uint64(0)
    drawn = 0
    for y in range(height - reach, reach, -1):
        for x in range(width - reach, reach, -1):
            if drawn % 4 == 0:
                bits = hash64(key, np.uint64(drawn // 4))
            drawn += 1
            here = y * width + x
            there = here + offsets[((bits & np.uint64(0xFFFF)) * count) >> np.uint64(16)]
            bits >>= np.uint64(16)
            value = source[np.uint64(here)]
            source[np.uint64(here)] = source[np.uint64(there)]
            if swap:
                source[np.uint64(there)] = value


@njit(cache=True, nogil=True)
def _gather(pixels: Any, source: Any, out: Any) -> None:
    """Take pixels (N, 3) at the indices `source` (N,)."""
    for i in range(source.size):
        at = np.uint64(source[i])
        out[i, 0] = pixels[at, 0]
        out[i, 1] = pixels[at, 1]
        out[i, 2] = pixels[at, 2]


LARGEST = 16 * 2**20
"""Maximum file size in bytes; the size of a stack is 2.9 million bytes."""


@lru_cache(maxsize=5)
def reference_field(folder: Path, rms: float) -> PsfField:
    """Load the reference code's PSFs of the lens with RMS radius `rms` from a folder with a `.pth` file per lens, such
    as "piece_1_fov34.0_fnum3.8_aper0_rms0.0832_idx2.pth": a float32 tensor (64, 3, 61, 61).

    The reference code correlates images with these arrays; for convolution, they are rotated by half a turn.
    """
    files = sorted(folder.glob(f"*rms{rms:.4f}*.pth"))
    if len(files) != 1:
        raise AssetError(
            folder,
            f"contains {len(files)} files named *rms{rms:.4f}*.pth, expected one; specify the folder with the "
            "reference code's five PSF stacks",
        )
    path = files[0]
    file = io.BytesIO(read_bounded(path, LARGEST, "a PSF stack has 2.9 million bytes"))
    require("torch", f"reading {path}")
    import torch

    try:
        tensor = load_tensors(file)
    except Exception as error:  # torch raises a different exception type for each kind of invalid file
        raise DataError(path, "not a PSF stack that can be read safely; use an unmodified .pth file") from error
    if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != SHAPE or tensor.dtype != torch.float32:
        raise DataError(path, f"not a single float32 tensor of shape {SHAPE}; use an unmodified .pth file")
    try:
        return PsfField(tensor.numpy()[:, :, ::-1, ::-1])
    except DataError as error:
        raise DataError(path, f"{error}; use an unmodified .pth file") from error


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
    paper_severities = (0.0296, 0.0832, 0.1102, 0.1588, 0.1939)

    def __init__(
        self, variant: str = "default", severities: tuple[Any, ...] | None = None, psf_dir: str | Path | None = None
    ) -> None:
        super().__init__(variant, severities)
        chosen = psf_dir if psf_dir is not None else os.environ.get(PSF_DIR)
        self.psf_dir = user_path(chosen) if chosen else None
        for rms in self.severities:
            if rms is not None and rms not in self.paper_severities:
                radii = ", ".join(str(value) for value in self.paper_severities)
                raise UsageError(self.name, f"no lens has an RMS radius of {rms} mm; choose from {radii}")

    def field(self, rms: float) -> PsfField:
        """Return the PSFs of the lens for a severity parameter."""
        if self.psf_dir is not None:
            return reference_field(self.psf_dir, rms)
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
        np.rint(blurred, out=blurred)
        return np.clip(blurred, 0.0, 255.0, out=blurred).astype(np.uint8, order="C")

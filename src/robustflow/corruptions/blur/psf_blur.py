"""Simulate a low-quality lens, whose PSF varies from the image centre to the corners."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UsageError
from ...layout import user_path
from ...psf.blur import blur
from ...psf.psf_field import PsfField
from ...psf.shipped import shipped_field
from ...sample import Frame
from ..base import Corruption
from .reference_stack import reference_field

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
    8 % smaller (`robustflow.psf.shipped.RMS_RADII`); set `psf_dir` to load the paper's lenses from the reference code's
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
        self,
        variant: str = "default",
        severities: tuple[Any, ...] | None = None,
        psf_dir: str | Path | None = None,
    ) -> None:
        """Create the corruption."""
        super().__init__(variant, severities)
        chosen = psf_dir if psf_dir is not None else os.environ.get(PSF_DIR)
        self.psf_dir = user_path(chosen) if chosen else None
        for rms in self.severities:
            if rms is not None and rms not in self.paper_severities:
                known = ", ".join(str(value) for value in self.paper_severities)
                raise UsageError(f"psf_blur has no lens with an RMS radius of {rms} mm: choose from {known}")

    def field(self, rms: float) -> PsfField:
        """Return the PSFs of the lens for a severity parameter."""
        if self.psf_dir is not None:
            return _reference(self.psf_dir, rms)
        return shipped_field(self.paper_severities.index(rms) + 1)

    @property
    def source(self) -> str:
        """Return the hashes of the reference code's five stacks, or an empty string for this package's lenses."""
        if self.psf_dir is None:
            return ""
        return "reference " + " ".join(self.field(rms).digest[:12] for rms in self.paper_severities)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        """Blur one frame."""
        blurred = blur(frame, self.field(state))
        if self.variant == "reference":
            np.floor(blurred + _WHOLE, out=blurred)
        return np.clip(np.rint(blurred), 0.0, 255.0).astype(np.uint8, order="C")


@lru_cache(maxsize=5)
def _reference(folder: Path, rms: float) -> PsfField:
    return reference_field(folder, rms)

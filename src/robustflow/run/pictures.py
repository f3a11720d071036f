"""Small pictures of corrupted frames, stored by workers for the severity slider of a page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.files import digest_of_bytes
from ..core.types import Frame
from ..media.images import jpeg_bytes, shrunk

SLIDER_WIDTH = 384
"""Maximum width of a slider picture in pixels, in the folder and on pages."""


def slider_picture(frames: tuple[Frame, ...], clean: tuple[Frame, ...]) -> bytes:
    """Return a JPEG of the first frame that a corruption changed: over_exposure changes only one of the two."""
    changed = [frame for frame, before in zip(frames, clean, strict=False) if not np.array_equal(frame, before)]
    return jpeg_bytes(shrunk((changed or frames)[0], SLIDER_WIDTH))


def picture_path(folder: Path, corruption: str, severity: int) -> Path:
    """Return where a worker stores the slider picture of a cell."""
    return folder / f"{digest_of_bytes(f'{corruption} {severity}'.encode(), size=16)}.jpg"

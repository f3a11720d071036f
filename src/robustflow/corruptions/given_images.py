"""Convert images passed by the user as arrays or Pillow images."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image

from ..errors import DataError
from ..sample import Frame

_EIGHT_BITS = ("RGB", "L", "P", "1")


def as_frame(image: Any) -> Frame:
    """Convert an image to RGB uint8 (H, W, 3); arrays are returned unchanged and checked later.

    >>> as_frame(Image.new("L", (4, 3), 7)).shape
    (3, 4, 3)
    """
    if not isinstance(image, Image.Image):
        return image
    if image.mode not in _EIGHT_BITS or "transparency" in image.info:
        raise DataError(f"an image has the mode {image.mode}: corruptions require 8-bit RGB; use image.convert('RGB')")
    return np.asarray(image.convert("RGB"))


def to_input_type(frame: Frame, given: Any) -> Any:
    """Convert a corrupted frame to the type of the input, a Pillow image or an array."""
    return Image.fromarray(frame) if isinstance(given, Image.Image) else frame

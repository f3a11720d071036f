"""Colour jitter: brightness, contrast, saturation and hue in random order, by Pillow like
torchvision's `ColorJitter`, which was used to train RAFT and its successors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageEnhance

from ...core.rng import Rng
from ...core.types import Frame

OPERATIONS = ("brightness", "contrast", "saturation", "hue")
_ENHANCE = {
    "brightness": ImageEnhance.Brightness,
    "contrast": ImageEnhance.Contrast,
    "saturation": ImageEnhance.Color,
}


class Strength(NamedTuple):
    """Strength of a jitter: factors from 1 - x to 1 + x, and a hue shift from -x to x turns of the colour circle."""

    brightness: float
    contrast: float
    saturation: float
    hue: float


DENSE = Strength(0.4, 0.4, 0.4, 0.5 / 3.14)
SPARSE = Strength(0.3, 0.3, 0.3, 0.3 / 3.14)


class Jitter(NamedTuple):
    """One set of drawn parameters: the factors, the hue shift, and the order of the four operations."""

    brightness: float
    contrast: float
    saturation: float
    hue: float
    order: tuple[str, ...]


def draw_jitter(rng: Rng, strength: Strength) -> Jitter:
    """Draw each factor uniformly within its strength, and a uniformly random order."""
    brightness, contrast, saturation = (rng.uniform(1 - most, 1 + most) for most in strength[:3])
    hue = rng.uniform(-strength.hue, strength.hue)
    order = list(OPERATIONS)
    for last in range(len(order) - 1, 0, -1):
        other = rng.integer(0, last + 1)
        order[last], order[other] = order[other], order[last]
    return Jitter(brightness, contrast, saturation, hue, tuple(order))


def apply_jitter(image: Frame, jitter: Jitter) -> Frame:
    """Change the colours of an image; return a new array, RGB uint8 (H, W, 3)."""
    picture = Image.fromarray(image)
    for operation in jitter.order:
        if operation == "hue":
            hue, saturation, value = picture.convert("HSV").split()
            turned = hue.point([(level + int(jitter.hue * 255)) & 255 for level in range(256)])
            picture = Image.merge("HSV", (turned, saturation, value)).convert("RGB")
        else:
            picture = _ENHANCE[operation](picture).enhance(getattr(jitter, operation))
    return np.array(picture)

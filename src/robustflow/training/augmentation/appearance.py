"""Draw and apply colour changes and blur for ARFlow's second pass (Liu et al., CVPR 2020)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageFilter

from ...random.rng import Rng
from ...sample import Frame
from ..objectives import Appearance
from .jitter import Jitter, Strength, apply_jitter, draw_jitter

_BLURRED = 0.5
"""Probability of blurring."""


class Look(NamedTuple):
    """One set of drawn parameters for both frames."""

    jitter: Jitter
    blur: float
    gamma: float


def draw_look(rng: Rng, settings: Appearance) -> Look:
    """Draw the colour change and the blur as in ARFlow."""
    strength = Strength(settings.brightness, settings.contrast, settings.saturation, 0.0)
    drawn = draw_jitter(rng, strength)
    drawn = drawn._replace(order=tuple(name for name in drawn.order if getattr(strength, name) > 0))
    blur = rng.uniform(0.0, settings.blur) if rng.uniform() < _BLURRED else 0.0
    return Look(drawn, blur, rng.uniform(*settings.gamma) if settings.gamma is not None else 1.0)


def apply_look(frame: Frame, look: Look) -> Frame:
    """Return the changed frame, RGB uint8 (H, W, 3), as a new array. The blur is Pillow's, as in the original."""
    changed = apply_jitter(frame, look.jitter)
    if look.blur > 0:
        changed = np.array(Image.fromarray(changed).filter(ImageFilter.GaussianBlur(look.blur)))
    if look.gamma != 1.0:
        table = np.rint(255 * (np.arange(256) / 255) ** look.gamma).astype(np.uint8)
        changed = table[changed]
    return changed.copy() if changed is frame else changed

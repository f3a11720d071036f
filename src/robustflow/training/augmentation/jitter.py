"""Colour jitter: brightness, contrast, saturation and hue in random order, byte-identical to torchvision's
`ColorJitter` on Pillow images, which was used to train RAFT and its successors."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.rng import Rng
from ...core.types import Frame

OPERATIONS = ("brightness", "contrast", "saturation", "hue")


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
    image = np.ascontiguousarray(image)
    for operation in jitter.order:
        if operation == "brightness":
            image = _mixed_with(image, 0, jitter.brightness)
        elif operation == "contrast":
            image = _mixed_with(image, int(_grey_sum(image) / (image.shape[0] * image.shape[1]) + 0.5), jitter.contrast)
        elif operation == "saturation":
            image = _saturated(image, np.float32(jitter.saturation))
        else:
            image = _turned(image, int(jitter.hue * 255) & 255, _hues(), _saturations())
    return image


def _mixed_with(image: Frame, grey: int, factor: float) -> Frame:
    """Compute Pillow's `blend` of a uniform grey and the image."""
    values = np.arange(256, dtype=np.float32)
    mixed = np.float32(grey) + np.float32(factor) * (values - np.float32(grey))
    table: npt.NDArray[np.uint8] = np.clip(mixed, 0, 255).astype(np.uint8)  # truncates like Pillow
    return cv2.LUT(image, table)


@inner
def _grey(red: Any, green: Any, blue: Any) -> Any:
    """Compute Pillow's luma (ITU-R 601-2) with 16 fractional bits."""
    return (np.int32(red) * 19595 + np.int32(green) * 38470 + np.int32(blue) * 7471 + 0x8000) >> 16


@njit(cache=True, nogil=True)
def _grey_sum(image: Any) -> Any:
    total = 0
    pixels = image.reshape(-1, 3)
    for i in range(pixels.shape[0]):
        total += _grey(pixels[i, 0], pixels[i, 1], pixels[i, 2])
    return total


@njit(cache=True, nogil=True)
def _saturated(image: Any, factor: Any) -> Any:
    out = np.empty_like(image)
    pixels, result = image.reshape(-1, 3), out.reshape(-1, 3)
    for i in range(pixels.shape[0]):
        grey = np.float32(_grey(pixels[i, 0], pixels[i, 1], pixels[i, 2]))
        for c in range(3):
            mixed = grey + factor * (np.float32(pixels[i, c]) - grey)
            result[i, c] = np.uint8(min(max(mixed, np.float32(0)), np.float32(255)))
    return out


@njit(cache=True, nogil=True)
def _turned(image: Any, turn: Any, hues: Any, saturations: Any) -> Any:
    """Convert to 8-bit HSV as in Pillow, shift the hue by `turn` / 256 of the colour circle, and convert back."""
    out = np.empty_like(image)
    pixels, result = image.reshape(-1, 3), out.reshape(-1, 3)
    for i in range(pixels.shape[0]):
        red, green, blue = np.int32(pixels[i, 0]), np.int32(pixels[i, 1]), np.int32(pixels[i, 2])
        most, least = max(red, green, blue), min(red, green, blue)
        s = saturations[most - least, most]
        if s == 0:
            result[i, 0] = result[i, 1] = result[i, 2] = most
            continue
        if red == most:
            case = 0 if blue == least else 1
        elif green == most:
            case = 2 if red == least else 3
        else:
            case = 4 if green == least else 5
        middle = red + green + blue - most - least
        h = (np.int32(hues[case, most - middle, most - least]) + turn) & 255
        position = np.float64(h) * 6.0 / 255.0
        sextant = np.int32(position)
        f = np.float32(position - np.float64(sextant))
        v, fs = np.float64(most), np.float32(np.float64(s) / 255.0)
        p = np.uint8(v * (1.0 - np.float64(fs)) + 0.5)
        if sextant % 2:
            between = np.uint8(v * (1.0 - np.float64(np.float32(fs * f))) + 0.5)
        else:
            between = np.uint8(v * (1.0 - np.float64(fs) * (1.0 - np.float64(f))) + 0.5)
        if sextant == 0 or sextant == 6:
            result[i, 0], result[i, 1], result[i, 2] = most, between, p
        elif sextant == 1:
            result[i, 0], result[i, 1], result[i, 2] = between, most, p
        elif sextant == 2:
            result[i, 0], result[i, 1], result[i, 2] = p, most, between
        elif sextant == 3:
            result[i, 0], result[i, 1], result[i, 2] = p, between, most
        elif sextant == 4:
            result[i, 0], result[i, 1], result[i, 2] = between, p, most
        else:
            result[i, 0], result[i, 1], result[i, 2] = most, p, between
    return out


@cache
def _hues() -> npt.NDArray[np.uint8]:
    """Return a table of Pillow's 8-bit hue, uint8 (6, 256, 256), indexed by the order of the channels and by how
    far the median and the smallest channel are below the largest."""
    below, spread = np.meshgrid(np.arange(256, dtype=np.float32), np.arange(256, dtype=np.float32), indexing="ij")
    spread[:, 0] = 1  # grey pixels have no hue and are never looked up in the table
    third, one = np.float64(below / spread), 1.0
    tables = [
        *(one - third, third - one),  # red is largest: its excess over blue minus that over green
        *(2.0 + one - third, 2.0 + third - one),  # green: 2 + excess over red minus that over blue
        *(4.0 + one - third, 4.0 + third - one),  # blue: 4 + excess over green minus that over red
    ]
    hue = np.fmod(np.stack(tables).astype(np.float32).astype(np.float64) / 6.0 + 1.0, 1.0).astype(np.float32)
    return np.clip((hue.astype(np.float64) * 255.0).astype(np.int64), 0, 255).astype(np.uint8)


@cache
def _saturations() -> npt.NDArray[np.uint8]:
    """Return a table of Pillow's 8-bit saturation, uint8 (256, 256), indexed by the channels' range and their
    maximum."""
    spread, most = np.meshgrid(np.arange(256, dtype=np.float32), np.arange(256, dtype=np.float32), indexing="ij")
    most[:, 0] = 1
    return np.clip(((spread / most).astype(np.float64) * 255.0).astype(np.int64), 0, 255).astype(np.uint8)

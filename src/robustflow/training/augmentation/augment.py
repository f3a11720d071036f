"""Augment a training pair: all parameters are drawn first, from one random stream, and then applied.

The eraser fills rectangles of the second frame with its mean colour, to simulate occlusion (RAFT). The look of ARFlow's
second pass is a change of colours and a blur (Liu et al., CVPR 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageFilter

from ...core.errors import DataError
from ...core.rng import Rng
from ...core.types import Flow, Frame, Mask
from ..recipe import Appearance, Part
from .geometry import Geometry, draw_geometry, padded, padding_for, scaled_size, warp_dense, warp_frame, warp_sparse
from .jitter import DENSE, SPARSE, Jitter, Strength, apply_jitter, draw_jitter

_PROBABILITY = 0.5
_SIDES = (50, 100)
"""Range of the side length in pixels, excluding the upper limit."""


class Rectangle(NamedTuple):
    """A rectangle in pixels; it may extend beyond the frame."""

    left: int
    top: int
    width: int
    height: int


def draw_eraser(rng: Rng, shape: tuple[int, int]) -> tuple[Rectangle, ...]:
    """Draw one or two rectangles with probability 1/2, otherwise none, anywhere in a frame of `shape` (H, W)."""
    if rng.uniform() >= _PROBABILITY:
        return ()
    height, width = shape
    return tuple(
        Rectangle(rng.integer(0, width), rng.integer(0, height), rng.integer(*_SIDES), rng.integer(*_SIDES))
        for _ in range(rng.integer(1, 3))
    )


def erase(frame: Frame, rectangles: tuple[Rectangle, ...]) -> Frame:
    """Return the frame with the rectangles filled, or the frame itself if there are none."""
    if not rectangles:
        return frame
    colour = frame.reshape(-1, 3).mean(axis=0).astype(np.uint8)  # truncated, as when assigning to uint8
    erased = frame.copy()
    for left, top, width, height in rectangles:
        erased[top : top + height, left : left + width] = colour
    return erased


_ASYMMETRIC = 0.2
"""Probability of a separate jitter for each frame of a dense pair."""
_EVEN = 0.5
"""Probability of a flip, and of swapping the frames, for training without labels."""


@dataclass(frozen=True)
class Augmentation:
    """One set of drawn parameters."""

    jitters: tuple[Jitter, ...]
    rectangles: tuple[Rectangle, ...]
    geometry: Geometry
    crop: tuple[int, int]
    sparse: bool
    padding: tuple[int, int] = (0, 0)
    swapped: bool = False


def draw_augmentation(rng: Rng, part: Part, shape: tuple[int, int], crop: tuple[int, int]) -> Augmentation:
    """Draw the augmentation of a pair, as specified by the part of the mix that it comes from; `shape` and `crop` are
    (H, W), in pixels.
    """
    if part.augmentation in ("stretched", "cropped"):
        return _draw_plain(rng, part, shape, crop)
    sparse = part.augmentation == "sparse"
    strength = SPARSE if sparse else DENSE
    jitters = 2 if not sparse and rng.uniform() < _ASYMMETRIC else 1
    rows, columns = padding = padding_for(shape, crop) if sparse else (0, 0)
    return Augmentation(
        tuple(draw_jitter(rng, strength) for _ in range(jitters)),
        draw_eraser(rng, shape) if part.eraser else (),
        draw_geometry(rng, (shape[0] + rows, shape[1] + columns), crop, part.log2_scale, part.flip, sparse),
        crop,
        sparse,
        padding,
    )


def _draw_plain(rng: Rng, part: Part, shape: tuple[int, int], crop: tuple[int, int]) -> Augmentation:
    """Draw the geometry (a stretch to the crop's size or a random crop, and flips) and whether to swap the frames
    (ARFlow, UPFlow)."""
    scale, top, left = None, 0, 0
    if part.augmentation == "stretched":
        scale = (crop[1] / shape[1], crop[0] / shape[0])
    else:
        margin = part.margin
        free = (shape[0] - 2 * margin - crop[0], shape[1] - 2 * margin - crop[1])
        if min(free) < 0:
            raise DataError(
                f"its frames are {shape[0]}x{shape[1]}, smaller than the crop of {crop[0]}x{crop[1]}"
                + (f" with a margin of {margin} pixels" if margin else "")
            )
        top, left = margin + rng.integer(0, free[0] + 1), margin + rng.integer(0, free[1] + 1)
    mirrored = part.flip and rng.uniform() < _EVEN
    geometry, swapped = Geometry(scale, mirrored, False, top, left), rng.uniform() < _EVEN
    return Augmentation((), (), geometry, crop, sparse=False, swapped=swapped)


def apply_augmentation(
    frames: tuple[Frame, Frame], flow: Flow, valid: Mask, drawn: Augmentation
) -> tuple[tuple[Frame, Frame], Flow, Mask]:
    """Augment a labelled pair for the network."""
    first, second = (warp_frame(frame, drawn.geometry, drawn.crop) for frame in _recoloured(frames, drawn))
    return (first, second), *_warped(flow, valid, drawn)


def augmented_whole(frames: tuple[Frame, Frame], drawn: Augmentation) -> tuple[Frame, Frame]:
    """Augment the frames of a pair without cropping; the crop starts at `top` and `left` of the geometry."""
    first, second = _recoloured(frames, drawn)
    shape = first.shape[:2]
    if drawn.geometry.scale is not None:
        width, height = scaled_size(shape, drawn.geometry.scale)
        shape = (height, width)
    geometry = drawn.geometry._replace(top=0, left=0)
    first, second = warp_frame(first, geometry, shape), warp_frame(second, geometry, shape)
    return (second, first) if drawn.swapped else (first, second)


def augmented_truth(flow: Flow, valid: Mask, drawn: Augmentation) -> tuple[Flow, Mask]:
    """Return the crop's flow and mask; no pixel is valid if the frames were swapped."""
    flow, valid = _warped(flow, valid, drawn)
    return flow, np.zeros_like(valid) if drawn.swapped else valid


def _warped(flow: Flow, valid: Mask, drawn: Augmentation) -> tuple[Flow, Mask]:
    warp = warp_sparse if drawn.sparse else warp_dense
    return warp(padded(flow, drawn.padding), padded(valid, drawn.padding), drawn.geometry, drawn.crop)


def _recoloured(frames: tuple[Frame, Frame], drawn: Augmentation) -> tuple[Frame, Frame]:
    """Return the frames after jitter, eraser and padding."""
    first, second = _jittered(frames, drawn.jitters)
    return padded(first, drawn.padding), padded(erase(second, drawn.rectangles), drawn.padding)


def _jittered(frames: tuple[Frame, Frame], jitters: tuple[Jitter, ...]) -> tuple[Frame, Frame]:
    if not jitters:
        return frames
    if len(jitters) == 2:
        return apply_jitter(frames[0], jitters[0]), apply_jitter(frames[1], jitters[1])
    both = apply_jitter(np.concatenate(frames), jitters[0])  # stacked, because contrast uses the mean of both frames
    height = frames[0].shape[0]
    return both[:height], both[height:]


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

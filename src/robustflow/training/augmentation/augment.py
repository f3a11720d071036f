"""Augment a training pair: all parameters are drawn first, from one random stream, and then applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import DataError
from ...random.rng import Rng
from ...sample import Flow, Frame, Mask
from ..recipe import Part
from .eraser import Rectangle, draw_eraser, erase
from .geometry import (
    Geometry,
    draw_geometry,
    padded,
    padding_for,
    scaled_size,
    warp_dense,
    warp_frame,
    warp_sparse,
)
from .jitter import DENSE, SPARSE, Jitter, apply_jitter, draw_jitter

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

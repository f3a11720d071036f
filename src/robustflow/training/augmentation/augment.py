"""A training pair, augmented: everything is drawn first, from one stream, and then applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...random.rng import Rng
from ...sample import Flow, Frame, Mask
from ..recipe import Part
from .eraser import Rectangle, draw_eraser, erase
from .geometry import Geometry, draw_geometry, warp_dense, warp_frame, warp_sparse
from .jitter import DENSE, SPARSE, Jitter, apply_jitter, draw_jitter

_ASYMMETRIC = 0.2
"""Probability of another jitter for each frame of a dense pair."""


@dataclass(frozen=True)
class Augmentation:
    """One draw.

    Attributes:
        jitters: one for both frames, or one for each.
        rectangles: erased from the second frame.
        geometry: scale, flips, crop.
        crop: (H, W).
        sparse: how the flow is scaled.
    """

    jitters: tuple[Jitter, ...]
    rectangles: tuple[Rectangle, ...]
    geometry: Geometry
    crop: tuple[int, int]
    sparse: bool


def draw_augmentation(rng: Rng, part: Part, shape: tuple[int, int], crop: tuple[int, int]) -> Augmentation:
    """What happens to a pair of this part of a mix; `shape` and `crop` are (H, W)."""
    sparse = part.augmentation == "sparse"
    strength = SPARSE if sparse else DENSE
    jitters = 2 if not sparse and rng.uniform() < _ASYMMETRIC else 1
    return Augmentation(
        tuple(draw_jitter(rng, strength) for _ in range(jitters)),
        draw_eraser(rng, shape),
        draw_geometry(rng, shape, crop, part.log2_scale, part.flip, sparse),
        crop,
        sparse,
    )


def apply_augmentation(
    frames: tuple[Frame, Frame], flow: Flow, valid: Mask, drawn: Augmentation
) -> tuple[tuple[Frame, Frame], Flow, Mask]:
    """The pair as the network sees it.

    Args:
        frames: RGB uint8 (H, W, 3).
        flow: float32 (H, W, 2), pixels.
        valid: bool (H, W).
        drawn: from `draw_augmentation`, for frames of this size.

    Returns:
        Frames, flow and mask of the crop's size; new arrays.
    """
    first, second = _jittered(frames, drawn.jitters)
    second = erase(second, drawn.rectangles)
    warp = warp_sparse if drawn.sparse else warp_dense
    flow, valid = warp(flow, valid, drawn.geometry, drawn.crop)
    return (
        (warp_frame(first, drawn.geometry, drawn.crop), warp_frame(second, drawn.geometry, drawn.crop)),
        flow,
        valid,
    )


def _jittered(frames: tuple[Frame, Frame], jitters: tuple[Jitter, ...]) -> tuple[Frame, Frame]:
    if len(jitters) == 2:
        return apply_jitter(frames[0], jitters[0]), apply_jitter(frames[1], jitters[1])
    both = apply_jitter(np.concatenate(frames), jitters[0])  # stacked: contrast takes the mean of both
    height = frames[0].shape[0]
    return both[:height], both[height:]

"""BrightFlow's loss without labels (Marsal et al., WACV 2023), written from its description: census, smoothness and
self-supervision over the flows of every iteration."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from ...models.torch.resize import resize_flow
from .occlusion import coverage, seen_by_check
from .photometric import Luma, census_sum, inner, robust
from .smoothness import charbonnier

GAMMA = 0.8
"""Weight of an iteration against the next one."""
RADIUS = 3
ALPHA = 150.0
"""How much an edge of the image, of values 0..1, lets the flow change."""
FARTHEST = 100.0
"""Pixels: what the self-supervision takes a student at most to be off by."""
LUMA: Luma = (0.2989, 0.1140, 0.5870)
"""Of red, green and blue: green and blue are exchanged in the official code."""


def over_iterations(losses: Sequence[Tensor]) -> Tensor:
    """The sum of losses, the last with weight 1 and each with GAMMA times the weight of the next.

    >>> round(over_iterations([torch.tensor(1.0), torch.tensor(1.0)]).item(), 4)
    1.8
    """
    return torch.stack([GAMMA ** (len(losses) - 1 - number) * loss for number, loss in enumerate(losses)]).sum()


def masked_census(image: Tensor, warped: Tensor, seen: Tensor) -> Tensor:
    """The robust census distance of two RGB images 0..1 (N, 3, H, W), its mean where `seen` (N, 1, H, W) is 1 and the
    window is inside; a scalar."""
    mask = seen * inner(seen, RADIUS)
    return (robust(census_sum(image, warped, RADIUS, LUMA)) * mask).sum() / (mask.sum() + 1e-6)


def seen_of(forward: Tensor, backward: Tensor, occlusion: str) -> Tensor:
    """How much of each pixel of frame 1 is seen in frame 2, 0..1 float (N, 1, H, W); no gradient goes through it.

    Args:
        forward, backward: (N, 2, H, W), pixels.
        occlusion: "brox", the forward-backward check, or "wang", what the backward flow splats there.
    """
    forward, backward = forward.detach(), backward.detach()
    return coverage(backward).clamp(0, 1) if occlusion == "wang" else seen_by_check(forward, backward)


def student_image(image: Tensor, border: int) -> Tensor:
    """An image (N, 3, H, W) without its border, enlarged to its size again."""
    size = (image.shape[2], image.shape[3])
    cut = image[:, :, border : size[0] - border, border : size[1] - border]
    return F.interpolate(cut, size, mode="bilinear", align_corners=True)


def self_supervised(students: Sequence[Tensor], teacher: Tensor, border: int) -> Tensor:
    """How far the student's flows of each iteration, from images without their border, are from the teacher's final
    one, cut and enlarged alike; a scalar. No gradient goes into the teacher (N, 2, H, W)."""
    height, width = teacher.shape[2:]
    cut = teacher.detach()[:, :, border : height - border, border : width - border]
    wanted = resize_flow(cut, (height, width))
    return over_iterations([charbonnier(flow - wanted).clamp(0, FARTHEST).mean() for flow in students])

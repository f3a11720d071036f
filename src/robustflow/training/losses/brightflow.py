"""BrightFlow's unsupervised loss (Marsal et al., WACV 2023): census, self-supervision and brightness correction.

Every loss is a mean over the pairs of a batch, so pairs do not influence each other. Images are RGB in 0..255.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ...models.networks.blocks.warp import leaves
from ...models.torch.resize import resize_flow
from .dilated_warp import inside_frame
from .occlusion import coverage, seen_by_check
from .photometric import Luma, census_sum, inner, robust
from .smoothness import charbonnier

GAMMA = 0.8
"""Weight of an iteration relative to the next one."""
RADIUS = 3
ALPHA = 150.0
"""Edge sensitivity of the smoothness, for images in 0..255; almost any edge allows a flow discontinuity."""
LUMA: Luma = (0.2989, 0.1140, 0.5870)
"""Weights of red, green and blue in the grey value; the official code swaps green and blue."""
_EPS = 1e-5


def over_iterations(losses: Sequence[Tensor]) -> Tensor:
    """Return the weighted sum of losses: the last one has weight 1; all others have GAMMA times the weight of the
    next.
    """
    return torch.stack([GAMMA ** (len(losses) - 1 - number) * loss for number, loss in enumerate(losses)]).sum()


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Average `values` (N, 1, H, W), weighted by `mask` (N, 1, H, W), over the pixels of each pair and then over the
    pairs."""
    pixels = (1, 2, 3)
    return ((values * mask).sum(pixels) / (mask.sum(pixels) + _EPS)).mean()


def masked_census(image: Tensor, warped: Tensor, visible: Tensor) -> Tensor:
    """Return the robust census distance of two images (N, 3, H, W), a scalar: the `masked_mean` over the pixels where
    `visible` (N, 1, H, W) is 1 and the window is inside the image."""
    distance = robust(census_sum(image, warped, RADIUS, LUMA))
    return masked_mean(distance, visible * inner(visible, RADIUS))


def visibility(forward: Tensor, backward: Tensor, corners: Tensor, sizes: Tensor, occlusion: str) -> Tensor:
    """Return the visibility of each pixel of a crop of frame 1 in the uncropped frame 2, float (N, 1, H, W), 0..1."""
    forward, backward = forward.detach(), backward.detach()
    seen = coverage(backward).clamp(0, 1) if occlusion == "wang" else seen_by_check(forward, backward)
    return torch.maximum(seen, leaves(forward).float()) * inside_frame(forward, corners, sizes)


def self_supervised(students: Sequence[Tensor], teacher: Tensor, border: int) -> Tensor:
    """Return the distance, a scalar, between the student's flows at all iterations, predicted from images without their
    border, and the teacher's final flow (N, 2, H, W), cropped and enlarged in the same way. No gradient is propagated
    to the teacher."""
    height, width = teacher.shape[2:]
    cut = teacher.detach()[:, :, border : height - border, border : width - border]
    wanted = resize_flow(cut, (height, width))
    return over_iterations([charbonnier(flow - wanted).sum(dim=1).mean() for flow in students])


def with_offsets(whole: Tensor, offsets: Tensor, corners: Tensor) -> Tensor:
    """Return uncropped frames (N, 3, H', W') with colour offsets (N, 3, H, W) added inside their crops."""
    height, width = offsets.shape[2:]
    corrected = whole.clone()
    for number, (x, y) in enumerate(corners.long().tolist()):
        corrected[number, :, y : y + height, x : x + width] += offsets[number]
    return corrected


def correction_loss(target: Tensor, warped: Tensor, visible: Tensor) -> Tensor:
    """Return the distance between corrected frames, warped to the target frames, and the target frames; a scalar."""
    return masked_mean((target - warped).abs().sum(dim=1, keepdim=True) / 255, visible)


def kept_offsets(target: Tensor, warped: Tensor, corrected: Tensor, flow: Tensor) -> Tensor:
    """Return a mask, float (N, 1, H, W), 1 where a source frame keeps its offsets, because they reduce its difference
    from the target frame. The frames are compared at the target pixels, and the flow maps the result to the source
    frame.
    """
    before, after = ((target - one).abs().mean(dim=1, keepdim=True) for one in (warped, corrected))
    return (coverage(flow, (after < before).float()) > 0).float()

"""BrightFlow's loss without labels (Marsal et al., WACV 2023): census, self-supervision, correction of brightness.

Every loss is a mean over the pairs of a batch, so that no pair depends on another. Images are RGB in 0..255.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ...models.torch.resize import resize_flow
from .dilated_warp import inside_frame, leaves
from .occlusion import coverage, seen_by_check
from .photometric import Luma, census_sum, inner, robust
from .smoothness import charbonnier

GAMMA = 0.8
"""Weight of an iteration against the next one."""
RADIUS = 3
ALPHA = 150.0
"""How much an edge of the image (0..255) lets the flow change: nearly any edge lets it jump."""
LUMA: Luma = (0.2989, 0.1140, 0.5870)
"""Weights of red, green and blue in grey; the official code exchanges green and blue."""
_EPS = 1e-5


def over_iterations(losses: Sequence[Tensor]) -> Tensor:
    """The sum of losses, the last with weight 1 and each with GAMMA times the weight of the next.

    >>> round(over_iterations([torch.tensor(1.0), torch.tensor(1.0)]).item(), 4)
    1.8
    """
    return torch.stack([GAMMA ** (len(losses) - 1 - number) * loss for number, loss in enumerate(losses)]).sum()


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """The mean of `values` (N, 1, H, W) weighted by `mask` (N, 1, H, W) in each pair, and of that over the pairs."""
    pixels = (1, 2, 3)
    return ((values * mask).sum(pixels) / (mask.sum(pixels) + _EPS)).mean()


def masked_census(image: Tensor, warped: Tensor, visible: Tensor) -> Tensor:
    """The robust census distance of two images (N, 3, H, W), a scalar: its `masked_mean` where `visible` (N, 1, H, W)
    is 1 and the window is inside."""
    distance = robust(census_sum(image, warped, RADIUS, LUMA, levels=1.0))
    return masked_mean(distance, visible * inner(visible, RADIUS))


def visibility(forward: Tensor, backward: Tensor, corners: Tensor, sizes: Tensor, occlusion: str) -> Tensor:
    """How much of each pixel of a crop of frame 1 is visible in the whole frame 2, float (N, 1, H, W) in 0..1.

    What leaves the crop counts as seen, because it is fetched from the whole frame; what leaves the frame does not. No
    gradient goes through it.

    Args:
        forward, backward: (N, 2, H, W), pixels.
        corners, sizes: of the crops and the whole frames, see `dilated_warp`.
        occlusion: "brox", the forward-backward check, or "wang", how much the backward flow splats there.
    """
    forward, backward = forward.detach(), backward.detach()
    seen = coverage(backward).clamp(0, 1) if occlusion == "wang" else seen_by_check(forward, backward)
    return torch.maximum(seen, leaves(forward)) * inside_frame(forward, corners, sizes)


def self_supervised(students: Sequence[Tensor], teacher: Tensor, border: int) -> Tensor:
    """How far the student's flows of all iterations, from images without their border, are from the teacher's final
    flow, cut and enlarged in the same way; a scalar. No gradient goes into the teacher (N, 2, H, W)."""
    height, width = teacher.shape[2:]
    cut = teacher.detach()[:, :, border : height - border, border : width - border]
    wanted = resize_flow(cut, (height, width))
    return over_iterations([charbonnier(flow - wanted).sum(dim=1).mean() for flow in students])


def with_offsets(whole: Tensor, offsets: Tensor, corners: Tensor) -> Tensor:
    """Whole frames (N, 3, H', W') with offsets (N, 3, H, W) of their colours added inside their crops."""
    height, width = offsets.shape[2:]
    corrected = whole.clone()
    for number, (x, y) in enumerate(corners.long().tolist()):
        corrected[number, :, y : y + height, x : x + width] += offsets[number]
    return corrected


def correction_loss(target: Tensor, warped: Tensor, visible: Tensor) -> Tensor:
    """How far corrected frames, warped to the target frames, are from these; a scalar.

    The `masked_mean` of the absolute difference, summed over red, green and blue of 0..1.
    """
    return masked_mean((target - warped).abs().sum(dim=1, keepdim=True) / 255, visible)


def kept_offsets(target: Tensor, warped: Tensor, corrected: Tensor, flow: Tensor) -> Tensor:
    """1 where a source frame keeps its offsets, float (N, 1, H, W): wherever a target pixel lands for which they help.

    Args:
        target: frames (N, 3, H, W).
        warped, corrected: the source frames, warped to the target frames without and with offsets.
        flow: from the target frames to the source frames, (N, 2, H, W).
    """
    without, with_them = ((target - one).abs().mean(dim=1, keepdim=True) for one in (warped, corrected))
    return (coverage(flow, (with_them < without).float()) > 0).float()

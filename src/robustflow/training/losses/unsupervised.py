"""The losses of ARFlow (Liu et al., "Learning by Analogy", CVPR 2020), UPFlow (Luo et al., CVPR 2021) and BrightFlow
(Marsal et al., WACV 2023), with the weights and terms of the authors' code.

Every loss is a mean over the pairs of a batch, so pairs do not influence each other. Images are RGB in 0..255.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional as F

from ...models.networks.blocks.pwc import leaves, warp
from ...models.torch.network_model import resize_flow
from ..recipe import UpflowObjective
from .terms import (
    Luma,
    census_distance,
    census_sum,
    charbonnier,
    coverage,
    inner,
    inside_frame,
    robust,
    seen_by_check,
    seen_by_splat,
    smoothness,
    ssim_distance,
    steps,
)


@dataclass(frozen=True)
class UnsupervisedLoss:
    """Weights and options of the loss."""

    l1: float = 0.15
    ssim: float = 0.85
    census: float = 0.0
    levels: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 0.0)
    smooth: float = 75.0
    smooth_levels: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 0.0)
    second_order: bool = True
    alpha: float = 10.0
    splat: bool = True
    both: bool = True


@dataclass(frozen=True)
class UnsupervisedTerms:
    """The terms of the loss."""

    photometric: Tensor
    smoothness: Tensor
    seen: Tensor

    @property
    def total(self) -> Tensor:
        """Return the loss."""
        return self.photometric + self.smoothness


def unsupervised_loss(
    forward: Sequence[Tensor], backward: Sequence[Tensor], image1: Tensor, image2: Tensor, weights: UnsupervisedLoss
) -> UnsupervisedTerms:
    """Compute the loss of a pyramid of flows."""
    photometric, smooth = image1.new_zeros(()), image1.new_zeros(())
    seen: tuple[Tensor, Tensor] | None = None
    shorter_side = min(forward[0].shape[2:])
    for there, back, level, smooth_level in zip(forward, backward, weights.levels, weights.smooth_levels, strict=True):
        if level == 0:
            continue
        size = tuple(there.shape[2:])
        first, second = (F.interpolate(image, size, mode="area") for image in (image1, image2))
        if seen is None:
            seen = _visibility_masks(there, back, weights)
        directions = [(first, second, there, F.interpolate(seen[0], size, mode="nearest"))]
        if weights.both:
            directions.append((second, first, back, F.interpolate(seen[1], size, mode="nearest")))
        for own, other, flow, mask in directions:
            share = 1 / len(directions)
            reconstructed = warp(other, flow, padding="border")
            photometric = photometric + level * share * _photometric(own, reconstructed, mask, weights)
            bent = smoothness(flow / shorter_side, own, weights.alpha, weights.second_order)
            smooth = smooth + weights.smooth * smooth_level * share * bent
    assert seen is not None, "a loss needs at least one level"
    return UnsupervisedTerms(photometric, smooth, seen[0])


def _visibility_masks(there: Tensor, back: Tensor, weights: UnsupervisedLoss) -> tuple[Tensor, Tensor]:
    """Return the masks of both frames; no gradient is propagated through them."""
    there, back = there.detach(), back.detach()
    if weights.splat:
        return seen_by_splat(back), seen_by_splat(there)
    return seen_by_check(there, back), seen_by_check(back, there)


def _photometric(image: Tensor, reconstructed: Tensor, seen: Tensor, weights: UnsupervisedLoss) -> Tensor:
    """Return the weighted sum of the terms' means over the frame, divided by the visible fraction of the frame."""
    total = image.new_zeros(())
    if weights.l1:
        total = total + weights.l1 * ((image - reconstructed).abs() * seen).mean()
    if weights.ssim:
        total = total + weights.ssim * ssim_distance(reconstructed * seen, image * seen).mean()
    if weights.census:
        total = total + weights.census * census_distance(reconstructed * seen, image * seen).mean()
    return total / seen.mean().clamp_min(1e-7)  # an untrained network may leave no pixel visible


@dataclass(frozen=True)
class OneWay:
    """One direction of a pair."""

    flow: Tensor
    levels: Sequence[Tensor]
    image: Tensor
    warped: Tensor
    seen: Tensor


def upflow_terms(ways: Sequence[OneWay], settings: UpflowObjective) -> dict[str, Tensor]:
    """Return the weighted terms of the loss, each a scalar, summed over both directions."""
    q = settings.exponent
    return {
        "photometric": _sum(settings.photometric * robust(way.image - way.warped, q).mean() for way in ways),
        "census": _sum(
            settings.census * robust(census_sum(way.image, way.warped, settings.radius), q).mean() for way in ways
        ),
        "smoothness": _sum(settings.smooth * edge_aware(way.flow, way.image) for way in ways),
        "distillation": _sum(settings.distillation * distillation(way, q) for way in ways),
    }


def distillation(way: OneWay, exponent: float = 0.4) -> Tensor:
    """Return the distance between the enlarged flow of each level and the final flow at visible pixels; a scalar."""
    height, width = way.flow.shape[2:]
    teacher, count = way.flow.detach(), way.seen.sum() + 1e-6
    far = [robust(resize_flow(level, (height, width)) - teacher, exponent) for level in way.levels]
    return _sum((distance * way.seen).sum() / count for distance in far)


def edge_aware(flow: Tensor, image: Tensor) -> Tensor:
    """Return the sum, over x and y, of the mean of |flow differences| times exp(-mean |image differences|)."""
    edges = ((-step.abs().mean(dim=1, keepdim=True)).exp() for step in steps(image))
    along_x, along_y = (step.abs() * weight for step, weight in zip(steps(flow), edges, strict=True))
    return along_x.mean() + along_y.mean()


def _sum(terms: Iterable[Tensor]) -> Tensor:
    return reduce(torch.add, terms)


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
    before, after = ((target - frame).abs().mean(dim=1, keepdim=True) for frame in (warped, corrected))
    return (coverage(flow, (after < before).float()) > 0).float()

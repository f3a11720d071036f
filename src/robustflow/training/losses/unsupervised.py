"""ARFlow's unsupervised loss (Liu et al., "Learning by Analogy", CVPR 2020): photometric difference of warped images at
visible pixels, and smoothness of the flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional as F

from ...models.networks.blocks.warp import warp
from .occlusion import seen_by_check, seen_by_splat
from .photometric import census_distance, ssim_distance
from .smoothness import smoothness


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

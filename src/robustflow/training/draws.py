"""Draw the random numbers of a step, except those for its pairs, as functions of the seed, the step and the
position."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.rng import Rng, key_of
from .data.loader import Batch
from .recipe import Recipe

DENOISING_STEPS = 1000
"""Number of steps of FlowDiffuser's noise schedule."""


def prepared(batch: Batch, recipe: Recipe, seed: int, step: int, positions: list[int]) -> Batch:
    """Add the random draws of a recipe to a batch."""
    return _with_denoising(_noisy(batch, recipe, seed, step, positions), recipe, seed, step, positions)


def _noisy(batch: Batch, recipe: Recipe, seed: int, step: int, positions: list[int]) -> Batch:
    """Add noise to both frames. All pairs of a step share one standard deviation, drawn uniformly from 0 to the
    recipe's maximum (FlowFormer)."""
    if not recipe.noise:
        return batch
    deviation = Rng.of(seed, "noise", step).uniform(0.0, recipe.noise)
    first, second = (
        with_noise(image, deviation, [key_of(seed, "noise", position, which) for position in positions], 255.0)
        for which, image in enumerate((batch.image1, batch.image2))
    )
    return replace(batch, image1=first, image2=second)


def with_noise(images: Tensor, deviation: float, keys: list[int], white: float) -> Tensor:
    """Add Gaussian noise of a standard deviation to images (N, 3, H, W), drawn with one key per image, and clip to 0..
    `white`."""
    drawn = torch.stack([normal(key, images.shape[1:]) for key in keys]).to(images.device)
    return (images + deviation * drawn).clamp(0.0, white)


def _with_denoising(batch: Batch, recipe: Recipe, seed: int, step: int, positions: list[int]) -> Batch:
    """Draw the noise step from which ground truth is denoised (shared by all pairs of a step) and the noise
    (FlowDiffuser)."""
    if recipe.loss != "denoising":
        return batch
    time = Rng.of(seed, "denoising", step).integer(0, DENOISING_STEPS)
    height, width = batch.flow.shape[2] // 8, batch.flow.shape[3] // 8
    drawn = [normal(key_of(seed, "denoising", position), (2, height, width)) for position in positions]
    return replace(batch, time=time, noise=torch.stack(drawn).to(batch.flow.device))


def normal(key: int, shape: tuple[int, ...]) -> Tensor:
    """Draw standard normal numbers on the CPU; the same key always yields the same numbers."""
    generator = torch.Generator().manual_seed(key % 2**63)
    return torch.randn(shape, generator=generator)

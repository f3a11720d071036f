"""GMFlowNet's loss on the matching from which its flow starts (Zhao et al., CVPR 2022, Sec. 3.4).

As the authors' code has it: the truth's vectors at every eighth pixel say which coarse pixel matches which; where
frame 1 and frame 2 fetched along the truth differ too much, and where the vector leaves the frame, nothing matches.
Pixels without ground truth are not left out; their vectors are 0.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ...errors import UsageError

MATCHING_WEIGHT = 0.01
"""Weight of this loss against the sequence loss."""
STRIDE = 8
"""Pixels between matched ones."""
OCCLUDED = 20.0
"""Grey levels by which the mean colours of a pixel and of its match differ at most."""
_LEAST = 1e-6
"""Smallest confidence, and smallest distance from 1, so that logarithms are finite."""


def matching_loss(confidence: Tensor, image1: Tensor, image2: Tensor, truth: Tensor) -> Tensor:
    """Mean of -log(confidence) over the matches, plus the mean of -log(1 - confidence) over all other pairs.

    Args:
        confidence: float (B, P, P) in 0..1, of the P coarse pixels of frame 1 matching those of frame 2.
        image1, image2: (B, 3, H, W), RGB 0..255, H and W multiples of 8.
        truth: flow (B, 2, H, W), pixels.

    Returns:
        A scalar. A batch without a match has only the second mean.

    Raises:
        UsageError: a confidence of another size.

    >>> frames, truth = torch.rand(1, 3, 16, 16), torch.zeros(1, 2, 16, 16)
    >>> bool(matching_loss(torch.eye(4)[None], frames, frames, truth) < 1e-4)
    True
    """
    rows, columns = truth.shape[2] // STRIDE, truth.shape[3] // STRIDE
    places = rows * columns
    if confidence.shape != (len(truth), places, places):
        raise UsageError(
            f"the network's confidence of matches has the shape {tuple(confidence.shape)}, expected "
            f"{(len(truth), places, places)}; crop to multiples of {STRIDE}"
        )
    matches = true_matches(image1, image2, truth)
    confidence = confidence.clamp(_LEAST, 1 - _LEAST)
    pair, place = (matches >= 0).nonzero(as_tuple=True)
    right = confidence[pair, place, matches[pair, place]]
    wrong = -(1 - confidence).log()
    wrong = wrong.index_put((pair, place, matches[pair, place]), wrong.new_zeros(()))
    others = confidence.numel() - len(pair)
    matched = -right.log().mean() if len(pair) else confidence.new_zeros(())
    return matched + wrong.sum() / others


@torch.no_grad()
def true_matches(image1: Tensor, image2: Tensor, truth: Tensor) -> Tensor:
    """Which coarse pixel of frame 2 each one of frame 1 matches by the truth: int64 (B, P), -1 for none; arguments as
    for `matching_loss`."""
    height, width = truth.shape[2:]
    y, x = torch.meshgrid(
        torch.arange(height, device=truth.device), torch.arange(width, device=truth.device), indexing="ij"
    )
    # The authors' sampling: pixel centres are taken for corners, half a pixel off.
    grid = torch.stack([2 * ((x + truth[:, 0]) / width - 0.5), 2 * ((y + truth[:, 1]) / height - 0.5)], dim=3)
    fetched = F.grid_sample(image2, grid, align_corners=False)
    occluded = (image1 - fetched).mean(dim=1).abs() > OCCLUDED
    rows, columns = height // STRIDE, width // STRIDE
    to_x = (x[:rows, :columns] + truth[:, 0, ::STRIDE, ::STRIDE] / STRIDE).round().long()
    to_y = (y[:rows, :columns] + truth[:, 1, ::STRIDE, ::STRIDE] / STRIDE).round().long()
    outside = (to_x < 0) | (to_x >= columns) | (to_y < 0) | (to_y >= rows)
    matches = (to_y * columns + to_x).masked_fill(outside | occluded[:, ::STRIDE, ::STRIDE], -1)
    return matches.flatten(1)

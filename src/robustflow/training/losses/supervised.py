"""RAFT's loss over the predictions of every iteration (Teed and Deng, ECCV 2020, Sec. 3.4), and GMFlowNet's loss for
the matching that initialises its flow (Zhao et al., CVPR 2022, Sec. 3.4).

As in the authors' code, the ground-truth vectors at every eighth pixel define the matches of coarse pixels. There is no
match if frame 1 and the warped frame 2 differ too much, or if the vector points outside the frame. Pixels without
ground truth are included with zero vectors.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from ...core.errors import UsageError

MAX_FLOW = 400.0
"""Maximum length of ground-truth vectors in pixels; longer ones are ignored, as in the original."""


def sequence_loss(
    flows: Sequence[Tensor], truth: Tensor, valid: Tensor, gamma: float = 0.8, max_flow: float = MAX_FLOW
) -> Tensor:
    """Return the sum over i of gamma^(n - 1 - i) * mean(|flow_i - truth|) for the n predictions."""
    if not flows:
        raise UsageError(
            "the network did not return any predictions to compare with the ground truth; return a list of flows"
        )
    counts = _counts(truth, valid, max_flow)
    total = truth.new_zeros(())
    for index, flow in enumerate(flows):
        if flow.shape != truth.shape:
            raise UsageError(
                f"prediction {index + 1}",
                f"has the shape {tuple(flow.shape)}, but the ground truth has {tuple(truth.shape)}; during training, a "
                "network must return flows at the frames' size",
            )
        total = total + gamma ** (len(flows) - 1 - index) * (counts * (flow.float() - truth).abs()).mean()
    return total


def end_point_error(flow: Tensor, truth: Tensor, valid: Tensor, max_flow: float = MAX_FLOW) -> Tensor:
    """Return the mean end-point error over the pixels used by `sequence_loss`, in pixels; NaN if there are none."""
    counts = _counts(truth, valid, max_flow)[:, 0]
    distances = (flow.float() - truth).square().sum(dim=1).sqrt()
    return distances[counts > 0].mean()


def _counts(truth: Tensor, valid: Tensor, max_flow: float) -> Tensor:
    """Return a mask (B, 1, H, W), 1 where a pixel is used, otherwise 0."""
    length = truth.square().sum(dim=1).sqrt()
    return ((valid >= 0.5) & (length < max_flow)).to(truth.dtype)[:, None]


MATCHING_WEIGHT = 0.01
"""Weight of this loss relative to the sequence loss."""
STRIDE = 8
"""Spacing of the matched pixels, in pixels."""
OCCLUDED = 20.0
"""Maximum difference between the mean colours of a pixel and its match, in grey levels."""
_LEAST = 1e-6
"""Minimum distance of a confidence from 0 and 1, so that logarithms are finite."""


def matching_loss(confidence: Tensor, image1: Tensor, image2: Tensor, truth: Tensor) -> Tensor:
    """Return the mean of -log(confidence) over the matches, plus the mean of -log(1 - confidence) over all other
    pairs.
    """
    rows, columns = truth.shape[2] // STRIDE, truth.shape[3] // STRIDE
    places = rows * columns
    if confidence.shape != (len(truth), places, places):
        raise UsageError(
            "--crop",
            f"the network's match confidence has the shape {tuple(confidence.shape)}, expected "
            f"{(len(truth), places, places)}; use multiples of {STRIDE}",
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
    """Return, for each coarse pixel of frame 1, the index of its ground-truth match in frame 2, int64 (B, P), -1 for
    none. Arguments as for `matching_loss`."""
    height, width = truth.shape[2:]
    y, x = torch.meshgrid(
        torch.arange(height, device=truth.device), torch.arange(width, device=truth.device), indexing="ij"
    )
    # The authors' sampling treats pixel centres as corners, so it is off by half a pixel.
    grid = torch.stack([2 * ((x + truth[:, 0]) / width - 0.5), 2 * ((y + truth[:, 1]) / height - 0.5)], dim=3)
    fetched = F.grid_sample(image2, grid, align_corners=False)
    occluded = (image1 - fetched).mean(dim=1).abs() > OCCLUDED
    rows, columns = height // STRIDE, width // STRIDE
    to_x = (x[:rows, :columns] + truth[:, 0, ::STRIDE, ::STRIDE] / STRIDE).round().long()
    to_y = (y[:rows, :columns] + truth[:, 1, ::STRIDE, ::STRIDE] / STRIDE).round().long()
    outside = (to_x < 0) | (to_x >= columns) | (to_y < 0) | (to_y >= rows)
    matches = (to_y * columns + to_x).masked_fill(outside | occluded[:, ::STRIDE, ::STRIDE], -1)
    return matches.flatten(1)

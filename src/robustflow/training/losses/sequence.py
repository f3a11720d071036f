"""RAFT's loss over the predictions of every iteration (Teed and Deng, ECCV 2020, Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ...errors import UsageError

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
                f"prediction {index + 1} has the shape {tuple(flow.shape)}, but the ground truth has "
                f"{tuple(truth.shape)}; during training, a network must return flows at the frames' size"
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

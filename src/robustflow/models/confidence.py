"""Predictions with a confidence: for any model the flow back, or the confidence that the model itself returns.

An answer is a flow with further channels: (H, W, 4) with the flow back, (H, W, 3) with the model's confidence or with
the spread of the flow over several draws of a corruption. Engines pass answers on as they pass flows; they are split
where they are measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from ..errors import ModelError, UsageError, unknown_name
from ..sample import Flow, Frame
from .base import AnyModel, ClipModel, FlowModel, checked_flow, naming_errors

FORWARD_BACKWARD, OF_MODEL = "forward-backward", "model"
CONFIDENCES = (FORWARD_BACKWARD, OF_MODEL)
"""Where a confidence can come from."""

Answer = npt.NDArray[np.float32]
"""A flow, with or without channels for its confidence: float32, shape (H, W, 2), (H, W, 3) or (H, W, 4)."""


CHANNELS = {None: 2, OF_MODEL: 3, FORWARD_BACKWARD: 4}
"""Number of channels of an answer for each confidence; None means a flow without one."""


@runtime_checkable
class ConfidentModel(FlowModel, Protocol):
    """A model that returns a confidence for every pixel."""

    def predict_with_confidence(self, frame1: Frame, frame2: Frame) -> tuple[Flow, npt.NDArray[np.floating[Any]]]:
        """The flow as from `predict`, and its confidence: float (H, W), larger where the flow is surer, any scale."""
        ...


def check_confidence(kind: str | None, model: AnyModel) -> None:
    """Raise unless a model can give this confidence.

    Raises:
        UsageError: an unknown kind, or one that the model does not have.
    """
    if kind is None:
        return
    if kind not in CONFIDENCES:
        raise unknown_name("confidence", kind, CONFIDENCES)
    if not isinstance(model, FlowModel) or isinstance(model, ClipModel):
        raise UsageError("a confidence is measured of models that predict from two frames; leave out --confidence")
    if kind == OF_MODEL and not isinstance(model, ConfidentModel):
        raise UsageError(
            "this model returns no confidence (no predict_with_confidence); give --confidence forward-backward"
        )


def with_spread(flows: Sequence[Flow]) -> Answer:
    """The first of some flows together with their standard deviation at each pixel: the root of the mean squared
    distance from the mean flow, with n - 1.

    >>> flow = np.zeros((1, 1, 2), np.float32)
    >>> with_spread([flow, flow + np.float32([6, 8])])[0, 0].tolist()
    [0.0, 0.0, 7.071067810058594]
    """
    each = np.stack(flows).astype(np.float64)
    away = ((each - each.mean(axis=0)) ** 2).sum(axis=(0, 3))
    spread = np.sqrt(away / (len(flows) - 1)).astype(np.float32)
    return np.concatenate([flows[0], spread[..., None]], axis=2)


def with_back(flow: Flow, back: Flow) -> Answer:
    """A flow together with the flow back."""
    return np.concatenate([flow, back], axis=2)


def predict_with_confidence_checked(model: ConfidentModel, frames: tuple[Frame, ...], where: str) -> Answer:
    """Call a model that gives its confidence, and check both parts of its answer; `where` names the frames in messages.

    Raises:
        ModelError: the model raised, or returned no flow, or a confidence of another size or that is NaN.
    """
    with naming_errors(where):
        answer = model.predict_with_confidence(frames[0].copy(), frames[1].copy())
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise ModelError(f"predict_with_confidence returned no pair (flow, confidence) on {where}")
    flow = checked_flow(answer[0], frames, where)
    try:
        confidence = np.asarray(answer[1], np.float32)
    except Exception:
        raise ModelError(f"the model's confidence on {where} is not an array of numbers") from None
    if confidence.shape != flow.shape[:2]:
        raise ModelError(
            f"the model's confidence on {where} has the shape {confidence.shape}; expected {flow.shape[:2]}, a number "
            "for each pixel"
        )
    if np.isnan(confidence).any():
        raise ModelError(
            f"the model's confidence is NaN at {int(np.isnan(confidence).sum())} pixels on {where}; give a number for "
            "each, -inf where nothing is known"
        )
    return np.concatenate([flow, confidence[..., None]], axis=2)


def flow_of(answer: Answer) -> Flow:
    """The flow of an answer: float32 (H, W, 2), pixels.

    >>> flow_of(np.zeros((4, 6, 3), np.float32)).shape
    (4, 6, 2)
    """
    return np.ascontiguousarray(answer[..., :2])

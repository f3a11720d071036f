"""Predict flow and a confidence, which is derived from the backward flow (for any model) or returned by the model.

An answer is a flow with extra channels: (H, W, 4) with the backward flow, or (H, W, 3) with the model's confidence or
with the standard deviation of the flow over several draws of a corruption. Engines handle answers like flows; the
metrics separate the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from ..core.errors import ModelError, UsageError, unknown_name
from ..core.text import counted
from ..core.types import Flow, Frame
from .calls import checked_flow, naming_errors
from .protocols import AnyModel, ClipModel, FlowModel

FORWARD_BACKWARD, OF_MODEL = "forward-backward", "model"
CONFIDENCES = (FORWARD_BACKWARD, OF_MODEL)
"""Valid sources of a confidence."""

Answer = npt.NDArray[np.float32]
"""A flow with or without extra confidence channels, float32 (H, W, 2), (H, W, 3) or (H, W, 4)."""


CHANNELS = {None: 2, OF_MODEL: 3, FORWARD_BACKWARD: 4}
"""Number of channels in an answer for each confidence source; the key None means no confidence."""


@runtime_checkable
class ConfidentModel(FlowModel, Protocol):
    """A model that returns a confidence for every pixel."""

    def predict_with_confidence(self, frame1: Frame, frame2: Frame) -> tuple[Flow, npt.NDArray[np.floating[Any]]]:
        """Return the same flow as `predict`, and its confidence: float (H, W) on any scale, larger where the flow is
        more reliable.
        """
        ...


def check_confidence(kind: str | None, model: AnyModel) -> None:
    """Raise an error unless the model supports this confidence source."""
    if kind is None:
        return
    if kind not in CONFIDENCES:
        raise unknown_name("confidence", kind, CONFIDENCES)
    if not isinstance(model, FlowModel) or isinstance(model, ClipModel):
        raise UsageError("--confidence", "only models that predict from two frames have one; omit this option")
    if kind == OF_MODEL and not isinstance(model, ConfidentModel):
        raise UsageError("--confidence", "this model has no predict_with_confidence; use forward-backward")


def with_spread(flows: Sequence[Flow]) -> Answer:
    """Combine the first of several flows with their standard deviation at each pixel: the root of the mean squared
    distance from the mean flow, with n - 1 in the denominator.

    >>> flow = np.zeros((1, 1, 2), np.float32)
    >>> with_spread([flow, flow + np.float32([6, 8])])[0, 0].tolist()
    [0.0, 0.0, 7.071067810058594]
    """
    draws = np.stack(flows).astype(np.float64)
    away = ((draws - draws.mean(axis=0)) ** 2).sum(axis=(0, 3))
    spread = np.sqrt(away / (len(flows) - 1)).astype(np.float32)
    return np.concatenate([flows[0], spread[..., None]], axis=2)


def with_back(flow: Flow, back: Flow) -> Answer:
    """Combine a flow with the backward flow."""
    return np.concatenate([flow, back], axis=2)


def predict_with_confidence_checked(model: ConfidentModel, frames: tuple[Frame, ...], where: str) -> Answer:
    """Call a model that returns a confidence, and check both; `where` describes the frames."""
    with naming_errors(where):
        answer = model.predict_with_confidence(frames[0].copy(), frames[1].copy())
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise ModelError(where, "predict_with_confidence did not return a pair (flow, confidence)")
    flow = checked_flow(answer[0], frames, where)
    try:
        confidence = np.asarray(answer[1], np.float32)
    except Exception:
        raise ModelError(where, "the model's confidence is not an array of numbers") from None
    if confidence.shape != flow.shape[:2]:
        shapes = f"the shape {confidence.shape}; expected {flow.shape[:2]}, one number per pixel"
        raise ModelError(where, f"the model's confidence has {shapes}")
    if (unknown := int(np.isnan(confidence).sum())) > 0:
        raise ModelError(
            where, f"the model's confidence is NaN at {counted(unknown, 'pixel')}; return -inf where it is unknown"
        )
    return np.concatenate([flow, confidence[..., None]], axis=2)


def flow_of(answer: Answer) -> Flow:
    """Return the flow channels of an answer, float32 (H, W, 2), in pixels."""
    return np.ascontiguousarray(answer[..., :2])

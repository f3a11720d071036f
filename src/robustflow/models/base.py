"""What RobustFlow asks of a model: two frames in, one flow out. No base class needed."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..errors import ModelError
from ..sample import Flow, Frame


@runtime_checkable
class FlowModel(Protocol):
    """Anything with `predict`.

    A model may also have `identity() -> dict` naming whatever changes its numbers (parameters, checkpoint hash,
    library version); it becomes part of a run's identity.
    """

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Flow from `frame1` to `frame2`: RGB uint8 (H, W, 3) in, float32 (H, W, 2) out, (u right, v down), pixels."""
        ...


@runtime_checkable
class FlowLookup(Protocol):
    """A model whose flows were computed elsewhere: it is asked by name instead of by frames."""

    def lookup(self, key: str, corruption: str, severity: int) -> Flow:
        """The flow of a sample; `corruption` is "clean" and `severity` 0 for the clean frames."""
        ...


def model_identity(model: Any) -> dict[str, Any]:
    """What names this model in a run's identity; the class name where the model says nothing itself."""
    if hasattr(model, "identity"):
        return dict(model.identity())
    kind = model if isinstance(model, type) or hasattr(model, "__qualname__") else type(model)
    return {"object": f"{kind.__module__}.{kind.__qualname__}"}


def predict_checked(
    model: FlowModel | FlowLookup, frames: tuple[Frame, ...], key: str, corruption: str, severity: int
) -> Flow:
    """Ask the model and check that the answer is a flow of the frames' size (its values may still be non-finite).

    Raises:
        ModelError: the model raised, or returned something that is not float (H, W, 2).
    """
    where = f"sample '{key}', {corruption}" + (f" severity {severity}" if severity else "")
    try:
        if isinstance(model, FlowLookup):
            flow = model.lookup(key, corruption, severity)
        else:
            flow = model.predict(frames[0], frames[1])
    except ModelError:
        raise
    except Exception as error:
        raise ModelError(
            f"the model raised {type(error).__name__} on {where}: {error or 'no message'}; "
            "run the model on this pair by itself to see why"
        ) from error
    flow = np.asarray(flow)
    expected = (*frames[0].shape[:2], 2)
    if flow.shape != expected or flow.dtype.kind != "f":
        raise ModelError(
            f"the model returned {flow.dtype} {flow.shape} on {where}; expected a float array of shape {expected}, "
            "(u right, v down) in pixels"
        )
    return np.ascontiguousarray(flow, np.float32)

"""The protocol of models: two frames in, or a clip for a multi-frame model; one flow out. No base class is needed."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from ..errors import ModelError, RobustFlowError, first_line
from ..sample import Flow, Frame
from .traceback_hint import traceback_hint
from .window import Window


@runtime_checkable
class FlowModel(Protocol):
    """Anything with `predict`.

    A model may also have `identity() -> dict` that lists everything that changes its numbers (parameters, checkpoint
    hash, library version); it becomes part of a run's identity. A model that computes on an accelerator declares it by
    an attribute `device` ("cuda:0"): frames are then corrupted and flows measured in other processes (see `devices`).
    One that is light and computes in one thread declares it by `single_threaded = True`: a long run of it, if it is
    named, then uses several processes by default.
    """

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Flow from `frame1` to `frame2`: RGB uint8 (H, W, 3) in, float32 (H, W, 2) out, (u right, v down), pixels."""
        ...


@runtime_checkable
class BatchedFlowModel(FlowModel, Protocol):
    """A model that predicts several pairs in one call, which changes a flow by 1e-4 px at most."""

    def predict_batch(self, frames1: Sequence[Frame], frames2: Sequence[Frame]) -> Sequence[Flow]:
        """The flows of as many pairs as there are first frames; shapes as in `predict`."""
        ...


@runtime_checkable
class ClipModel(Protocol):
    """A multi-frame model: it declares which frames around the pair it needs, and gets them together with the pair.

    All frames of a clip are corrupted by one draw, and the pair is byte for byte the one that a two-frame model gets
    (see docs/design/architecture.md). Nothing may be kept from one call to the next: samples come in any order, and in
    several processes. A model that also has `predict` is given only the two frames if a data set has no more.

    Attributes:
        window: (before, after): frames before frame 1 and after frame 2; or a `Window`, which also states what happens
            at the ends of a sequence.
    """

    window: tuple[int, int] | Window

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """Flow from `frames[index]` to `frames[index + 1]`, as `FlowModel.predict` gives it.

        Args:
            frames: RGB uint8 (H, W, 3) each, of one size, in the order of time. With the window (before, after) always
                before + 2 + after of them: at either end of the sequence, its outermost frame is repeated for the
                missing ones.
            index: of frame 1 of the pair; with the window (before, after) always `before`.
        """
        ...


@runtime_checkable
class Differentiable(Protocol):
    """A model whose flow has a gradient with respect to its frames, which white-box attacks need.

    Padding, scaling and the order of the colours are inside: a perturbation belongs to the frame as a file holds it.
    """

    def differentiable(self, images1: Any, images2: Any) -> Any:
        """The flow of a pair as part of PyTorch's graph, on the device of the images or on the model's own.

        Args:
            images1: tensor (1, 3, H, W), float32, RGB in 0..1.
            images2: as `images1`.

        Returns:
            Tensor (1, 2, H, W), (u right, v down) in pixels.
        """
        ...


@runtime_checkable
class FlowLookup(Protocol):
    """A model whose flows were computed elsewhere: they are looked up by sample instead of predicted from frames."""

    def lookup(self, key: str, corruption: str, severity: int) -> Flow:
        """The flow of a sample; `corruption` is "clean" and `severity` 0 for the clean frames."""
        ...


AnyModel: TypeAlias = FlowModel | ClipModel | FlowLookup
"""Everything that can be evaluated."""


def model_identity(model: Any) -> dict[str, Any]:
    """The model's part of a run's identity; its class name if the model does not provide one."""
    if hasattr(model, "identity"):
        identity = model.identity()
        if not isinstance(identity, Mapping):
            raise ModelError(
                f"the model's identity() returned {type(identity).__name__}; "
                "expected a dict of what changes its numbers"
            )
        try:
            text = json.dumps({str(key): identity[key] for key in identity}, default=str, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise ModelError(
                f"the model's identity() cannot be written as JSON ({first_line(error)}); return numbers that are "
                "finite, texts, and lists and dicts of them"
            ) from error
        named: dict[str, Any] = json.loads(text)
        return named
    kind = model if isinstance(model, type) or hasattr(model, "__qualname__") else type(model)
    return {"object": f"{kind.__module__}.{kind.__qualname__}"}


def given_name(model: Any) -> str | None:
    """The name that a user's own model gives itself: its attribute `name`, if that is a string; otherwise None.

    >>> class Mine:
    ...     name = "My model"
    >>> given_name(Mine()), given_name(print.__self__)
    ('My model', None)
    """
    name = getattr(model, "name", None)
    return name.strip() or None if isinstance(name, str) and not isinstance(model, ModuleType) else None


def predict_checked(
    model: FlowModel | FlowLookup, frames: tuple[Frame, ...], key: str, corruption: str, severity: int
) -> Flow:
    """Call the model and check that the result is a flow of the frames' size (its values may still be non-finite).

    Raises:
        ModelError: the model raised, or returned something that is not float (H, W, 2).
    """
    where = describe_cell(key, corruption, severity)
    with naming_errors(where):
        if isinstance(model, FlowLookup):
            flow = model.lookup(key, corruption, severity)
        else:
            flow = model.predict(*_copies(frames[:2]))
    return checked_flow(flow, frames, where)


def predict_clip_checked(
    model: ClipModel, frames: tuple[Frame, ...], index: int, key: str, corruption: str, severity: int
) -> Flow:
    """Like `predict_checked`, for a multi-frame model; `index` is that of frame 1 of the pair."""
    where = describe_cell(key, corruption, severity)
    with naming_errors(where):
        flow = model.predict_clip(_copies(frames), index)
    return checked_flow(flow, frames, where)


def predict_batch_checked(
    model: BatchedFlowModel, pairs: Sequence[tuple[Frame, ...]], cells: Sequence[tuple[str, str, int]]
) -> list[Flow]:
    """Like `predict_checked`, for several pairs in one call of the model; each cell is (key, corruption, severity)."""
    where = describe_cells(cells)
    with naming_errors(where):
        flows = list(model.predict_batch(*([frames[i].copy() for frames in pairs] for i in (0, 1))))
    if len(flows) != len(pairs):
        raise ModelError(f"the model returned {len(flows)} flows for {len(pairs)} pairs on {where}; expected one each")
    return [
        checked_flow(flow, frames, describe_cell(*cell)) for flow, frames, cell in zip(flows, pairs, cells, strict=True)
    ]


def describe_cell(key: str, corruption: str, *severities: int) -> str:
    """Describe the cell in which something happened.

    >>> describe_cell("a", "fog", 1, 2), describe_cell("a", "clean", 0)
    ("sample 'a', fog severity 1, 2", "sample 'a', clean")
    """
    levels = ", ".join(str(severity) for severity in severities if severity)
    return f"sample '{key}', {corruption}" + (f" severity {levels}" if levels else "")


def describe_cells(cells: Sequence[tuple[str, str, int]]) -> str:
    """Describe several cells (key, corruption, severity).

    >>> describe_cells([("a", "fog", 1), ("a", "fog", 2), ("a", "snow", 1)])
    "sample 'a', fog severity 1, 2; sample 'a', snow severity 1"
    """
    severities: dict[tuple[str, str], list[int]] = {}
    for key, corruption, severity in cells:
        severities.setdefault((key, corruption), []).append(severity)
    return "; ".join(describe_cell(*name, *levels) for name, levels in severities.items())


@contextmanager
def naming_errors(where: str) -> Iterator[None]:
    """Turn whatever a model raises into a `ModelError` that says where."""
    process = os.getpid()
    try:
        yield
    except RobustFlowError as error:
        raise ModelError(f"{error} (on {where})") from error
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        # Where Ctrl-C is ignored, as in a worker process, it was the model that raised this.
        if isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            raise
        raise ModelError(
            f"the model raised {type(error).__name__} on {where}: {' '.join(str(error).split()) or 'no message'}"
            f"{traceback_hint(error)}; give --debug for the full traceback"
        ) from error
    finally:
        if os.getpid() != process:
            os._exit(1)  # a process that the model forked would otherwise continue the run itself


def _copies(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Copy frames for the model, which may write into its input: they are still needed to corrupt, measure and draw."""
    return tuple(frame.copy() for frame in frames)


def checked_flow(flow: Any, frames: tuple[Frame, ...], where: str) -> Flow:
    """Check what a model returned, and convert it to a flow: float32 (H, W, 2) of the frames' size.

    Raises:
        ModelError: it is not float, or of another shape.
    """
    expected = (*frames[0].shape[:2], 2)
    try:
        array = np.asarray(flow)
    except Exception as error:  # a tensor on a GPU, or one that requires gradients; rows of different lengths
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ModelError(
            f"the model returned a {type(flow).__name__} on {where} that is not an array ({reason}); return a NumPy "
            "array, of a tensor flow.detach().cpu().numpy()"
        ) from error
    if array.shape != expected or array.dtype.kind != "f":
        what = type(flow).__name__ if array.dtype.kind == "O" else f"{array.dtype} {array.shape}"
        raise ModelError(
            f"the model returned {what} on {where}; expected a float array of shape {expected}, "
            "(u right, v down) in pixels"
        )
    return np.ascontiguousarray(array, np.float32)

"""Check a user-defined model before using it in a benchmark, and provide small models with known flow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..attacks.ball import images_of
from ..attacks.evaluation import Evaluation, evaluate
from ..attacks.gradient import check_same_flow
from ..core.errors import ModelError, raise_interrupt
from ..core.text import counted
from ..core.types import Flow, Frame, described_array
from ..metrics.photometric import misread
from ..models.confidence import ConfidentModel, flow_of, predict_with_confidence_checked
from ..models.protocols import AnyModel, BatchedFlowModel, ClipModel, Differentiable, FlowModel, given_name, window_of
from ..run.identity import checked_name
from ..run.plan import name_model

_SHAPES = ((128, 160), (121, 147))
"""An even frame size, and one that is not a multiple of any common stride."""
_MOTIONS = ((2, 1), (-1, 2))
"""Motion (u, v) of the two clips, in pixels from frame to frame."""
BATCH_TOLERANCE = 1e-4
"""Maximum change in the flow due to batching, in pixels; see `BatchedFlowModel`."""


class ConstantFlow:
    """A minimal model that predicts the same flow (u, v), in pixels, everywhere.

    >>> ConstantFlow(3, -1).predict(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2, 3), np.uint8))[0, 0].tolist()
    [3.0, -1.0]
    """

    def __init__(self, u: float = 0.0, v: float = 0.0) -> None:
        self._flow = (float(u), float(v))

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`."""
        return {"name": "constant_flow", "flow": list(self._flow)}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`."""
        flow = np.empty((*frame1.shape[:2], 2), np.float32)
        flow[:] = self._flow
        return flow


class ZeroFlow(ConstantFlow):
    """A model that predicts zero flow; the baseline that every useful model must beat.

    >>> ZeroFlow().predict(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2, 3), np.uint8)).any()
    np.False_
    """

    def __init__(self) -> None:
        super().__init__()


class ZeroClipFlow:
    """A multi-frame model that predicts zero flow.

    Args:
        window: number of additional input frames before and after the pair, as (before, after) or a `Window`.

    >>> frames = [np.zeros((2, 2, 3), np.uint8)] * 3
    >>> ZeroClipFlow((1, 0)).predict_clip(frames, 1).shape
    (2, 2, 2)
    """

    def __init__(self, window: Any = (1, 1)) -> None:
        self.window = window

    def identity(self) -> dict[str, Any]:
        """See `ClipModel`."""
        return {"name": "zero_clip_flow"}

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """See `ClipModel.predict_clip`."""
        return np.zeros((*frames[index].shape[:2], 2), np.float32)


class BrightnessFlow:
    """A model that predicts (mean of frame 1, mean of frame 2) / 16 everywhere, so that its flow depends on the frames.

    >>> BrightnessFlow().predict(np.full((2, 2, 3), 16, np.uint8), np.zeros((2, 2, 3), np.uint8))[0, 0].tolist()
    [1.0, 0.0]
    """

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`."""
        return {"name": "brightness_flow"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`."""
        return ConstantFlow(float(frame1.mean()) / 16, float(frame2.mean()) / 16).predict(frame1, frame2)


def check_model(model: Any, seed: int = 0) -> str:
    """Check a model on textured frames of two sizes, and return its name.

    The flow must be a finite float array (H, W, 2), and frame 2 warped by it must not explain frame 1 clearly worse
    than with swapped, negated or rescaled components. The same frames must result in the same flow, even after
    predictions on different frames and in any order. The model must not modify its input frames. Batched predictions
    must match the flows of single pairs to within 1e-4 px; the same applies to `differentiable` if the model has
    `batched_gradients`. With PyTorch installed, `differentiable` must return the flow of `predict`.
    `predict_with_confidence` must return the same flow as `predict`, and a confidence, (H, W) without NaN, that is
    the same on every call. A multi-frame model receives a clip with the frames of its window.

    Args:
        model: the model: an object or class with `predict` or `predict_clip`, a function of two frames, or a PyTorch
            module.
        seed: the seed for the frames.

    Raises:
        ModelError: a check failed; the message states the problem and the frame size.
        UsageError: the model declares an unknown training set, or a name that cannot be used.

    >>> check_model(ConstantFlow(1, 0))
    'ConstantFlow'
    """
    named = name_model(model)
    made, _ = named.model, named.training  # raises if the training set is unknown
    if named.name:
        checked_name(named.name)
    rng = np.random.default_rng(seed)
    for shape in _SHAPES:
        where = f"on frames of {shape[0]}x{shape[1]}"
        clips = [_clip(made, rng, shape, motion) for motion in _MOTIONS]
        first, other, again = (_predict(made, clip, where) for clip in (*clips, clips[0]))
        _require(
            np.array_equal(first, again),
            "predict",
            f"returns a different flow for the same frames {where} (off by up to {np.abs(first - again).max():.2g} px) "
            "after other predictions; seed all random number generators, and keep no state between calls",
        )
        _check_format(made, zip(clips, (first, other), strict=True), where)
        if isinstance(made, BatchedFlowModel) and not isinstance(made, ClipModel):
            _check_batch(made, clips, [first, other], where)
        if isinstance(made, Differentiable) and find_spec("torch"):
            _check_differentiable(made, clips, [first, other], where)
        if isinstance(made, ConfidentModel):
            _check_confidence(made, clips, first, where)
    return given_name(model) or getattr(model, "__name__", None) or type(model).__name__


def _require(holds: Any, culprit: str, message: str) -> None:
    if not holds:
        raise ModelError(culprit, message)


def _called(method: str, function: Callable[[], Any], where: str) -> Any:
    try:
        return function()
    except ModelError:
        raise
    except BaseException as error:
        raise_interrupt(error)
        raise ModelError(method, f"raised {type(error).__name__} {where}: {error or 'no message'}") from error


def _predict(model: AnyModel, clip: list[Frame], where: str) -> Flow:
    copies = [frame.copy() for frame in clip]
    if isinstance(model, ClipModel):
        flow = _called("predict_clip", lambda: model.predict_clip(copies, window_of(model).before), where)
    elif isinstance(model, FlowModel):
        flow = _called("predict", lambda: model.predict(copies[0], copies[1]), where)
    else:
        raise ModelError("precomputed flows are looked up by name, so there is no prediction to check")
    _require(all(map(np.array_equal, copies, clip)), "predict", f"modifies its input frames {where}; copy them first")
    shape = (*clip[0].shape[:2], 2)
    _require(
        isinstance(flow, np.ndarray) and flow.shape == shape and flow.dtype.kind == "f",
        "predict",
        f"returned {described_array(flow)} {where}; expected a float array {shape}, (u right, v down) in pixels",
    )
    wrong = int((~np.isfinite(flow)).any(axis=2).sum())
    _require(not wrong, "predict", f"returned NaN or infinity at {counted(wrong, 'pixel')} {where}")
    return np.array(flow, copy=True)


def _check_format(model: AnyModel, predicted: Iterable[tuple[list[Frame], Flow]], where: str) -> None:
    start = window_of(model).before if isinstance(model, ClipModel) else 0
    wrong = misread([(clip[start], clip[start + 1], flow.astype(np.float32)) for clip, flow in predicted])
    if wrong is not None:
        raise ModelError(
            wrong.reading.describe(),
            f"this is how the flow {where} looks: {wrong.describe()}; return (u right, v down) in pixels from frame 1 "
            "to frame 2",
        )


def _check_batch(model: BatchedFlowModel, clips: list[list[Frame]], alone: list[Flow], where: str) -> None:
    name = "predict_batch"
    copies = [[clip[i].copy() for clip in clips] for i in (0, 1)]
    together = _called(name, lambda: model.predict_batch(*copies), where)
    unchanged = all(np.array_equal(copies[i][j], clip[i]) for i in (0, 1) for j, clip in enumerate(clips))
    _require(unchanged, name, f"modifies its input frames {where}; copy them first")
    _require(
        hasattr(together, "__len__"), name, f"returned {described_array(together)} {where}; return one flow per pair"
    )
    _require(
        len(together) == len(clips), name, f"returned {counted(len(together), 'flow')} for {len(clips)} pairs {where}"
    )
    for flow, single in zip(together, alone, strict=True):
        _require(
            np.shape(flow) == single.shape and np.abs(np.asarray(flow) - single).max() <= BATCH_TOLERANCE,
            name,
            f"returns a different flow {where} than for single pairs; process the pairs of a batch independently, or "
            "do not implement it",
        )


def _check_differentiable(model: AnyModel, clips: list[list[Frame]], flows: list[Flow], where: str) -> None:
    import torch

    for clip, flow in zip(clips, flows, strict=True):
        check_same_flow(model, evaluate(Evaluation(model, where, images=images_of(*clip[:2]))).flow, flow, where)
    if getattr(model, "batched_gradients", False) is not True:
        return
    assert isinstance(model, Differentiable)
    pairs = torch.from_numpy(np.stack([images_of(*clip[:2]) for clip in clips]))
    with torch.no_grad():
        together = model.differentiable(pairs[:, 0].contiguous(), pairs[:, 1].contiguous())
        single = torch.cat([model.differentiable(pair[:1], pair[1:]) for pair in pairs])
    _require(
        together.shape == single.shape and (together - single).abs().max() <= BATCH_TOLERANCE,
        "differentiable",
        f"returns a different flow {where} in a batch than for single pairs; process the pairs of a batch "
        "independently, or do not set batched_gradients",
    )


def _check_confidence(model: ConfidentModel, clips: list[list[Frame]], flow: Flow, where: str) -> None:
    name, frames = "predict_with_confidence", where.removeprefix("on ")
    first, _, again = (predict_with_confidence_checked(model, tuple(clip), frames) for clip in (*clips, clips[0]))
    same = np.array_equal(flow_of(first), np.asarray(flow, np.float32))
    _require(same, name, f"returns a different flow than predict {where}; return the same flow")
    _require(
        np.array_equal(first, again),
        name,
        f"returns a different confidence for the same frames {where} after other predictions; seed all random number "
        "generators, and keep no state between calls",
    )


def _clip(model: AnyModel, rng: np.random.Generator, shape: tuple[int, int], motion: tuple[int, int]) -> list[Frame]:
    """Return a smooth texture that moves from frame to frame."""
    count = 2
    if isinstance(model, ClipModel):
        window = window_of(model)
        count = window.before + 2 + window.after
    coarse = rng.integers(0, 256, (shape[0] // 8 + count + 2, shape[1] // 8 + 2 * count + 2, 3)).astype(np.float32)
    big = coarse.repeat(8, axis=0).repeat(8, axis=1)
    for axis in (0, 1):
        big = np.mean([np.roll(big, step, axis) for step in range(-4, 5)], axis=0)
    big = np.clip(big, 0, 255).astype(np.uint8)
    size = shape[0], shape[1]
    starts = [(2 * count - motion[1] * i, 2 * count - motion[0] * i) for i in range(count)]
    return [np.ascontiguousarray(big[y : y + size[0], x : x + size[1]]) for y, x in starts]

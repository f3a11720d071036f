"""Evaluate a model for attacks, and run several attacks in lockstep so that they share model calls.

The code of an attack handles a single pair. In lockstep, each attack has its own thread, but only one thread runs at a
time: it pauses when it needs the model, and continues with the answer. A model on the CPU evaluates each pair
separately, so lockstep does not change any bytes. A model with `batched_gradients` evaluates pairs of equal size in one
call.
"""

from __future__ import annotations

import contextvars
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from ..core.errors import ModelError, StoppedError
from ..core.types import Flow, Frame
from ..models.calls import describe_cells, naming_errors, predict_batch_checked, predict_checked
from ..models.protocols import AnyModel, BatchedFlowModel, Differentiable, FlowModel
from .ball import Images
from .loss import Loss

_Result = TypeVar("_Result")

_PATIENCE = 5.0
"""Maximum time to wait for an interrupted thread, in seconds."""

_EXPECTED = "expected a tensor (N, 2, H, W) computed from the images inside PyTorch's graph"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A request for a flow: for 8-bit frames, or for images, optionally with the gradient of a loss."""

    model: AnyModel
    key: str
    frames: tuple[Frame, Frame] | None = None
    images: Images | None = None
    loss: Loss | None = None
    whole: bool = True
    """Whether networks are differentiated through `detach` (see `models.torch.whole`)."""

    @property
    def cell(self) -> tuple[str, str, int]:
        """The cell named in error messages."""
        return self.key, "an attacked pair", 0

    @property
    def group(self) -> tuple[Any, ...]:
        """A key that is equal for evaluations that can share a model call."""
        group = () if getattr(self.model, "batched_gradients", False) is True else (id(self),)
        arrays = [(array.shape, array.dtype.char) for array in (*(self.frames or ()), self.images) if array is not None]
        return id(self.model), self.images is None, self.loss is None, self.whole, *arrays, *group


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to an evaluation."""

    flow: Flow
    value: float = float("nan")
    gradient: Images | None = None


def evaluate(asked: Evaluation) -> Answer:
    """Evaluate a model: immediately, or together with the other attacks when called inside `in_lockstep`."""
    thread = threading.current_thread()
    return thread.ask(asked) if isinstance(thread, _Lane) else _answers([asked])[0]


def in_lockstep(tasks: Sequence[Callable[[], _Result]]) -> list[_Result]:
    """Run functions that call `evaluate` in lockstep, and return their results in order."""
    if len(tasks) == 1:
        return [tasks[0]()]
    lanes = [_Lane(task) for task in tasks]
    with _settings():
        try:
            for lane in lanes:
                lane.resume(None)
            while waiting := [lane for lane in lanes if lane.asked is not None]:
                groups: dict[tuple[Any, ...], list[_Lane[_Result]]] = {}
                for lane in waiting:
                    groups.setdefault(lane.asked.group, []).append(lane)  # type: ignore[union-attr]
                for group in groups.values():
                    try:
                        answers: Sequence[Answer | Exception] = _answers([lane.asked for lane in group if lane.asked])
                    except Exception as error:  # raised inside the attack, as without lockstep
                        answers = [error] * len(group)
                    for lane, answer in zip(group, answers, strict=True):
                        lane.resume(answer)
        finally:
            for lane in lanes:
                lane.stop()
    return [lane.result for lane in lanes]


def _settings() -> Any:
    """Return a context with reproducible settings of PyTorch, which attacks change and restore in any order."""
    if "torch" not in sys.modules:
        return nullcontext()
    from ..models.torch.network_model import reproducible

    return reproducible()


class _Lane(threading.Thread, Generic[_Result]):
    """The thread of one attack."""

    result: _Result

    def __init__(self, task: Callable[[], _Result]) -> None:
        super().__init__(daemon=True)
        self.asked: Evaluation | None = None
        self._task, self._context = task, contextvars.copy_context()
        self._answer: Answer | Exception | None = None
        self._error: BaseException | None = None
        self._stopped = False
        self._go, self._paused = threading.Semaphore(0), threading.Semaphore(0)
        self.start()

    def run(self) -> None:
        """Wait for the first call of `resume`, then run the function."""
        self._go.acquire()
        try:
            if not self._stopped:
                self.result = self._context.run(self._task)
        except BaseException as error:
            self._error = error
        self._paused.release()

    def ask(self, evaluation: Evaluation) -> Answer:
        """Pause until the evaluation is answered; called from this thread."""
        self.asked = evaluation
        self._paused.release()
        self._go.acquire()
        if self._stopped:
            raise StoppedError
        if isinstance(self._answer, Exception):
            raise self._answer
        assert self._answer is not None
        return self._answer

    def resume(self, answer: Answer | Exception | None) -> None:
        """Let the thread run until it pauses or ends, and raise the exception that ended it."""
        self._answer, self.asked = answer, None
        self._go.release()
        self._paused.acquire()
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """End the thread at its next pause."""
        self._stopped = True
        self._go.release()
        self.join(_PATIENCE)


def _answers(asked: Sequence[Evaluation]) -> list[Answer]:
    """Answer the evaluations of one group."""
    model = asked[0].model
    if asked[0].frames is None:
        return _differentiated(asked)
    cells, pairs = [query.cell for query in asked], [query.frames for query in asked if query.frames is not None]
    assert isinstance(model, FlowModel)
    if len(asked) > 1 and isinstance(model, BatchedFlowModel):
        return list(map(Answer, predict_batch_checked(model, pairs, cells)))
    return [Answer(predict_checked(model, pair, *cell)) for pair, cell in zip(pairs, cells, strict=True)]


def _differentiated(asked: Sequence[Evaluation]) -> list[Answer]:
    """Compute flows, and gradients if requested, with PyTorch."""
    import torch

    from ..models.torch.network_model import reproducible
    from ..models.torch.whole import as_written

    model, gradient = asked[0].model, asked[0].loss is not None
    assert isinstance(model, Differentiable)
    where = describe_cells([query.cell for query in asked])
    images = torch.from_numpy(np.stack([query.images for query in asked if query.images is not None]))
    images.requires_grad_(gradient)
    with reproducible(getattr(model, "threads", 1)), naming_errors(where):
        with torch.set_grad_enabled(gradient), nullcontext() if asked[0].whole else as_written():
            flow = model.differentiable(images[:, 0].contiguous(), images[:, 1].contiguous())
        shape = tuple(flow.shape) if isinstance(flow, torch.Tensor) else type(flow).__name__
        if shape != (len(asked), 2, *images.shape[3:]) or (gradient and not flow.requires_grad):
            raise ModelError("differentiable", f"the model's method returned {shape}; {_EXPECTED}")
        values = flow.detach() if images.dtype == torch.float64 else flow.detach().float()
        flows = np.ascontiguousarray(values.cpu().numpy().transpose(0, 2, 3, 1))
        if not gradient:
            return list(map(Answer, flows))
        slopes = [query.loss.slope(there) for query, there in zip(asked, flows, strict=True) if query.loss is not None]
        above = np.ascontiguousarray(np.stack([slope for _, slope in slopes]).transpose(0, 3, 1, 2))
        (pulled,) = torch.autograd.grad(flow, images, torch.from_numpy(above).to(flow), allow_unused=True)
    if pulled is None:
        raise ModelError("differentiable", f"its flow does not depend on the images; {_EXPECTED}")
    gradients = pulled.cpu().numpy()
    return [Answer(there, value, slope) for there, (value, _), slope in zip(flows, slopes, gradients, strict=True)]

"""The model protocols: a model maps two frames, or a clip of frames, to one flow. No base class is needed."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, get_args, runtime_checkable

import numpy as np

from ..core.errors import ModelError, RobustFlowError, class_and_message, first_line, raise_interrupt
from ..core.plugins import working_folder_kept
from ..core.source_digest import source_digest
from ..core.text import counted
from ..core.types import Flow, Frame, unmasked
from .devices import traceback_hint


@runtime_checkable
class FlowModel(Protocol):
    """A model that predicts flow from two frames; any object with `predict` qualifies.

    A model may also define `identity() -> dict`, which lists everything that affects its results (parameters,
    checkpoint hash, library version) and becomes part of a run's identity. A model that runs on an accelerator sets the
    attribute `device` ("cuda:0"), so that separate processes corrupt the frames and evaluate the flows (see `devices`).
    A lightweight model that runs in one thread sets `single_threaded = True`; if it is loaded by name, long runs then
    use several processes by default.
    """

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict the flow from `frame1` to `frame2`, RGB uint8 (H, W, 3), as float32 (H, W, 2), (u right, v down), in
        pixels.
        """
        ...


@runtime_checkable
class BatchedFlowModel(FlowModel, Protocol):
    """A model that predicts several pairs in one call; batching must not change a flow by more than 1e-4 px."""

    def predict_batch(self, frames1: Sequence[Frame], frames2: Sequence[Frame]) -> Sequence[Flow]:
        """Predict one flow for each pair of frames; shapes as in `predict`."""
        ...


@runtime_checkable
class ClipModel(Protocol):
    """A multi-frame model, which declares how many frames around the pair it needs, and receives them with the pair.

    All frames of a clip are corrupted with the same random draw, and the pair is byte-identical to the one that a
    two-frame model receives (see docs/design/architecture.md). The model must not keep state between calls, because
    samples are predicted in any order and by several processes. If a dataset has only pairs, a model that also has
    `predict` receives only the two frames.

    Attributes:
        window: numbers of additional frames before and after the pair, as (before, after), or a `Window`, which also
            defines the behaviour at the ends of a sequence.
    """

    window: tuple[int, int] | Window

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """Predict the flow from `frames[index]` to `frames[index + 1]`, in the format of `FlowModel.predict`.

        Args:
            frames: frames of equal size in temporal order, RGB uint8 (H, W, 3) each. With the window (before, after),
                there are always before + 2 + after frames: at the ends of the sequence, the outermost frame is repeated
                to replace missing frames.
            index: index of frame 1 of the pair in `frames`; with the window (before, after) always `before`.
        """
        ...


@runtime_checkable
class Differentiable(Protocol):
    """A model whose flow is differentiable with respect to its frames, as white-box attacks require."""

    def differentiable(self, images1: Any, images2: Any) -> Any:
        """Return the flow of each pair as part of PyTorch's autograd graph, on the device of the images or of the
        model.
        """
        ...


@runtime_checkable
class FlowLookup(Protocol):
    """A model with precomputed flows, which are looked up by sample instead of being predicted from frames."""

    def lookup(self, key: str, corruption: str, severity: int) -> Flow:
        """Return the flow of a sample; for clean frames `corruption` is "clean" and `severity` is 0."""
        ...


AnyModel: TypeAlias = FlowModel | ClipModel | FlowLookup
"""Any model that can be evaluated."""


def model_identity(model: Any) -> dict[str, Any]:
    """Return the model's part of a run's identity; if it defines none, the name of its class or function, and its
    source if that is a file."""
    if hasattr(model, "identity"):
        identity = model.identity()
        if not isinstance(identity, Mapping):
            expected = "expected a dict of everything that affects the model's results"
            raise ModelError("identity", f"it returned {type(identity).__name__}; {expected}")
        try:
            text = json.dumps({str(key): identity[key] for key in identity}, default=str, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            advice = "return only finite numbers, strings, and lists and dicts of these"
            reason = f"the model's identity cannot be written as JSON ({first_line(error)})"
            raise ModelError("identity", f"{reason}; {advice}") from error
        named: dict[str, Any] = json.loads(text)
        return named
    kind = model if isinstance(model, type) or hasattr(model, "__qualname__") else type(model)
    is_code = inspect.isclass(kind) or inspect.isfunction(kind)
    has_file = is_code and kind.__module__ != "__main__" and "<locals>" not in kind.__qualname__
    source = {"source": source_digest(kind)} if has_file else {}
    return {"object": f"{kind.__module__}.{kind.__qualname__}", **source}


def given_name(model: Any) -> str | None:
    """Return the name that a user-defined model declares in its attribute `name`, or None if it is not a string.

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
    """Call the model and check that the result is a flow of the frames' size (its values may still be non-finite)."""
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
    """Call a multi-frame model like `predict_checked`; `index` is the index of frame 1 of the pair."""
    where = describe_cell(key, corruption, severity)
    with naming_errors(where):
        flow = model.predict_clip(_copies(frames), index)
    return checked_flow(flow, frames, where)


def predict_batch_checked(
    model: BatchedFlowModel, pairs: Sequence[tuple[Frame, ...]], cells: Sequence[tuple[str, str, int]]
) -> list[Flow]:
    """Predict several pairs in one call, checked like `predict_checked`; a cell is (key, corruption, severity)."""
    where = describe_cells(cells)
    with naming_errors(where):
        flows = list(model.predict_batch(*([frames[i].copy() for frames in pairs] for i in (0, 1))))
    if len(flows) != len(pairs):
        raise ModelError(
            where,
            f"returned {counted(len(flows), 'flow')} for {counted(len(pairs), 'pair')}; expected one per pair",
        )
    return [
        checked_flow(flow, frames, describe_cell(*cell)) for flow, frames, cell in zip(flows, pairs, cells, strict=True)
    ]


def describe_cell(key: str, corruption: str, *severities: int) -> str:
    """Describe a cell for error messages.

    >>> describe_cell("a", "fog", 1, 2), describe_cell("a", "clean", 0)
    ("sample 'a', fog severity 1, 2", "sample 'a', clean")
    """
    levels = ", ".join(str(severity) for severity in severities if severity)
    return f"sample '{key}', {corruption}" + (f" severity {levels}" if levels else "")


def describe_cells(cells: Sequence[tuple[str, str, int]]) -> str:
    """Describe several cells (key, corruption, severity) for error messages.

    >>> describe_cells([("a", "fog", 1), ("a", "fog", 2), ("a", "snow", 1)])
    "sample 'a', fog severity 1, 2; sample 'a', snow severity 1"
    """
    severities: dict[tuple[str, str], list[int]] = {}
    for key, corruption, severity in cells:
        severities.setdefault((key, corruption), []).append(severity)
    return "; ".join(describe_cell(*name, *levels) for name, levels in severities.items())


@contextmanager
def naming_errors(where: str) -> Iterator[None]:
    """Convert any exception raised by a model to a `ModelError` that states where; keep the working folder."""
    try:
        with working_folder_kept():
            yield
    except RobustFlowError as error:
        *culprit, message = error.args
        raise ModelError(*culprit, f"{message} (on {where})") from error
    except BaseException as error:
        raise_interrupt(error)
        reason = f"{class_and_message(error)}{traceback_hint(error)}"
        message = f"the model raised {reason}; use --debug for the full traceback"
        raise ModelError(where, message) from error


def _copies(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Copy frames for the model, which may modify its input; the originals are still needed elsewhere."""
    return tuple(frame.copy() for frame in frames)


def checked_flow(flow: Any, frames: tuple[Frame, ...], where: str) -> Flow:
    """Check a result and copy it to a flow (H, W, 2), because models reuse arrays; masked values become NaN."""
    expected = (*frames[0].shape[:2], 2)
    try:
        array = np.asarray(unmasked(flow))
    except Exception as error:  # e.g. a GPU tensor, a tensor that requires gradients, or rows of unequal length
        reason = " ".join(str(error).split()) or type(error).__name__
        message = f"the model returned a {type(flow).__name__}, not an array ({reason})"
        raise ModelError(where, f"{message}; for a tensor, return flow.detach().cpu().numpy()") from error
    if array.shape != expected or array.dtype.kind != "f":
        what = type(flow).__name__ if array.dtype.kind == "O" else f"{array.dtype} {array.shape}"
        wanted = f"expected a float array of shape {expected}, (u right, v down) in pixels"
        raise ModelError(where, f"the model returned {what}; {wanted}")
    return np.array(array, np.float32, order="C")


Ends = Literal["repeat", "short", "inside"]


class Window(NamedTuple):
    """Frames around a pair, as offsets from frame 1 of the pair; frame 1 has offset 0, and frame 2 has offset 1."""

    before: int
    after: int = 0
    ends: Ends = "repeat"

    @property
    def reach(self) -> int:
        """The largest distance between a frame and the pair, in frames."""
        return self.before + self.after

    def offsets(self, there: range) -> tuple[int, ...]:
        """Return the offsets of the frames that the model receives, in order."""
        offsets = range(-self.before, self.after + 2)
        if self.ends == "repeat":
            return tuple(min(max(offset, there.start), there.stop - 1) for offset in offsets)
        if self.ends == "inside":
            start = max(there.start, min(offsets.start, there.stop - len(offsets)))
            offsets = range(start, start + len(offsets))
        return tuple(offset for offset in offsets if offset in there)

    def record(self) -> dict[str, Any]:
        """Return the window's entry in a run's identity."""
        return self._asdict()


def window_of(model: Any) -> Window:
    """Return the window that a multi-frame model declares."""
    declared = model.window
    parts = tuple(declared) if isinstance(declared, tuple | list) else ()
    counts, ends = parts[:2], parts[2:]
    counts_valid = len(counts) == 2 and all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in counts)
    if not (counts_valid and sum(counts) and ends in ((), *((end,) for end in get_args(Ends)))):
        wanted = "(before, after), the numbers of frames before frame 1 and after frame 2, at least one in total"
        ends_text = f"and optionally the behaviour at the ends: {', '.join(get_args(Ends))}"
        raise ModelError("window", f"it is {declared!r}; declare {wanted}, {ends_text}")
    return Window(*parts)


def place_of_pair(offsets: tuple[int, ...]) -> int:
    """Return the index of frame 1 of the pair."""
    return offsets.index(1) - 1

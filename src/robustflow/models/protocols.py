"""The model protocols: a model maps two frames, or a clip of frames, to one flow. No base class is needed."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, get_args, runtime_checkable

from ..core.errors import ModelError, first_line
from ..core.source_digest import source_digest
from ..core.types import Flow, Frame


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

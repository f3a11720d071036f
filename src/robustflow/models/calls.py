"""Call a model: any exception that it raises names the cell, and its answer is checked."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ModelError, RobustFlowError, class_and_message, raise_interrupt
from ..core.plugins import working_folder_kept
from ..core.text import counted
from ..core.types import Flow, Frame, unmasked
from .protocols import BatchedFlowModel, ClipModel, FlowLookup, FlowModel


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


_PACKAGE = str(Path(__file__).resolve().parent.parent)


def traceback_hint(error: BaseException) -> str:
    """Return the last line of user code in a traceback as " (at net.py:12)"; if there is none, return the last line of
    the traceback.

    >>> try:
    ...     {}["a"]
    ... except KeyError as error:
    ...     print(traceback_hint(error).endswith(":2)"))
    True
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.lineno]
    if not frames:
        return ""
    user = [frame for frame in frames if not _is_library(frame.filename)]
    outside = [frame for frame in frames if not frame.filename.startswith(_PACKAGE)]
    last = (user or outside or frames)[-1]
    return f" (at {last.filename}:{last.lineno})"


def _is_library(file: str) -> bool:
    return file.startswith(_PACKAGE) or "site-packages" in file or "dist-packages" in file or "/lib/python" in file

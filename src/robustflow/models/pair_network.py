"""The inputs and outputs of networks: check pairs of frames, group those of equal size, find the axis of the flow."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ..core.errors import ModelError, UsageError
from ..core.text import first_of
from ..core.types import Flow, Frame, described_array


class PairNetwork(ABC):
    """A network that predicts batches of pairs of equal size."""

    @property
    @abstractmethod
    def _batches_pairs(self) -> bool:
        """Whether pairs of equal size are batched: on a GPU, if the network's batch size is dynamic."""

    @abstractmethod
    def run(self, frames1: list[Frame], frames2: list[Frame]) -> list[Flow]:
        """Call the network once for pairs of equal size; the result is the same as from `predict_batch`."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`."""
        return self.predict_batch([frame1], [frame2])[0]

    def predict_batch(self, frames1: Sequence[Frame], frames2: Sequence[Frame]) -> list[Flow]:
        """Return the flows of several pairs; those of equal size share calls where the network batches pairs."""
        if len(frames1) != len(frames2):
            raise UsageError("frames2", f"{len(frames2)} second frames for {len(frames1)} first frames; pass pairs")
        sizes: dict[tuple[int, ...], list[int]] = {}
        for i, (frame1, frame2) in enumerate(zip(frames1, frames2, strict=True)):
            check_pair(frame1, frame2)
            sizes.setdefault(frame1.shape if self._batches_pairs else (i,), []).append(i)
        flows: dict[int, Flow] = {}
        for members in sizes.values():
            together = self.run([frames1[i] for i in members], [frames2[i] for i in members])
            flows.update(zip(members, together, strict=True))
        return [flows[i] for i in range(len(frames1))]


def check_pair(frame1: Frame, frame2: Frame) -> None:
    """Check the input frames of a model."""
    for frame in (frame1, frame2):
        if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise UsageError(described_array(frame), "not a frame; expected RGB uint8 (H, W, 3)")
    if frame1.shape != frame2.shape:
        raise UsageError(str(frame2.shape[:2]), f"the size of frame 2; frame 1 has {frame1.shape[:2]}")


def flow_layout(shape: Sequence[int], pairs: int, height: int, width: int) -> Literal["nchw", "nhwc"]:
    """Return the axis of an output that contains (u, v), from its shape; channels first if both are possible.

    >>> flow_layout((1, 40, 64, 2), 1, 40, 64)
    'nhwc'
    """
    if tuple(shape) == (pairs, 2, height, width):
        return "nchw"
    if tuple(shape) == (pairs, height, width, 2):
        return "nhwc"
    expected = f"{(pairs, 2, height, width)} or {(pairs, height, width, 2)}"
    raise ModelError(
        str(tuple(shape)),
        f"the shape of the network's flow for {pairs} inputs of {height}x{width}; expected {expected}: change the "
        "network, or choose a different output with -O output=",
    )


def describe_arrays(arrays: Sequence[tuple[str, Sequence[Any] | None]]) -> str:
    """Format names and shapes for messages.

    >>> describe_arrays([("image1", (1, 3, None, None)), ("x", None)])
    'image1 (1, 3, ?, ?), x (unknown shape)'
    """
    described = []
    for name, shape in arrays:
        sides = None if shape is None else ", ".join("?" if side is None else str(side) for side in shape)
        described.append(f"{name[:60]!s} ({'unknown shape' if sides is None else sides})")
    return first_of(described, 8) or "none"

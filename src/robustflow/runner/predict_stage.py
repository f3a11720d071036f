"""The second stage of a cell: ask the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..models.base import (
    AnyModel,
    BatchedFlowModel,
    ClipModel,
    FlowLookup,
    FlowModel,
    describe_cells,
    predict_batch_checked,
    predict_checked,
    predict_clip_checked,
)
from ..sample import Flow, Frame
from .seconds import Seconds, timed

if TYPE_CHECKING:  # a process that only predicts does not import what plans need
    from ..runs.plan import Cell


@dataclass(frozen=True)
class PredictionRequest:
    """A request for the flow of one cell.

    Attributes:
        cell: (sample key, corruption, severity).
        frames: RGB uint8 (H, W, 3) each: the pair, or the clip in the order of time.
        index: of frame 1 in the clip; None for a model that is given pairs.
    """

    cell: Cell
    frames: tuple[Frame, ...]
    index: int | None = None


class PredictStage:
    """Calls a model, and checks that it returns flows.

    Args:
        model: loaded.
        seconds: where "predict" is counted.
        on_predict: called with what is being predicted before each call of the model, and with None after it, so that
            its time can be watched.
    """

    def __init__(
        self, model: AnyModel, seconds: Seconds, on_predict: Callable[[str | None], None] = lambda what: None
    ) -> None:
        self._model = model
        self._seconds = seconds
        self._on_predict = on_predict

    def predict(self, requests: Sequence[PredictionRequest]) -> list[Flow]:
        """The flows of some cells: several in one call, if the model can; a single one goes through `predict`.

        Raises:
            ModelError: the model raised, or returned something that is not float (H, W, 2).
        """
        with timed(self._seconds, "predict"):
            self._on_predict(describe_cells([request.cell for request in requests]))
            if len(requests) > 1 and requests[0].index is None and isinstance(self._model, BatchedFlowModel):
                cells = [request.cell for request in requests]
                flows = predict_batch_checked(self._model, [request.frames for request in requests], cells)
            else:
                flows = [self._one(request) for request in requests]
            self._on_predict(None)
            return flows

    def _one(self, request: PredictionRequest) -> Flow:
        if request.index is not None:
            assert isinstance(self._model, ClipModel)
            return predict_clip_checked(self._model, request.frames, request.index, *request.cell)
        assert isinstance(self._model, FlowModel | FlowLookup)
        return predict_checked(self._model, request.frames, *request.cell)

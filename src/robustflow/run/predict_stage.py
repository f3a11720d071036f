"""The second stage of a cell: predict its flow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..core.types import Flow, Frame
from ..models.base import (
    AnyModel,
    BatchedFlowModel,
    ClipModel,
    FlowLookup,
    FlowModel,
    describe_cell,
    describe_cells,
    predict_batch_checked,
    predict_checked,
    predict_clip_checked,
)
from ..models.confidence import (
    FORWARD_BACKWARD,
    OF_MODEL,
    Answer,
    ConfidentModel,
    predict_with_confidence_checked,
    with_back,
    with_spread,
)
from .seconds import Seconds, timed

if TYPE_CHECKING:  # a process that only predicts does not import the modules that plans need
    from .cells import Cell


@dataclass(frozen=True)
class PredictionRequest:
    """A request for the flow of one cell."""

    cell: Cell
    frames: tuple[Frame, ...]
    index: int | None = None
    draws: int = 1


class PredictStage:
    """Call a model, and check that it returns flows."""

    def __init__(
        self,
        model: AnyModel,
        confidence: str | None,
        seconds: Seconds,
        on_predict: Callable[[str | None], None],
    ) -> None:
        self._model = model
        self._confidence = confidence
        self._seconds = seconds
        self._on_predict = on_predict

    def predict(self, requests: Sequence[PredictionRequest]) -> list[Answer]:
        """Predict the flow of requests, in one call if the model supports batches; a single request uses `predict`."""
        with timed(self._seconds, "predict"):
            if requests[0].draws > 1:
                answers = list(map(self._predict_draws, requests))
            elif self._confidence == OF_MODEL:
                answers = list(map(self._predict_with_confidence, requests))
            else:
                answers = self._flows(requests)
            if self._confidence == FORWARD_BACKWARD:
                answers = list(map(with_back, answers, self._flows_back(requests, answers)))
            return answers

    @contextmanager
    def _announced(self, *requests: PredictionRequest) -> Iterator[None]:
        """Wrap one call of the model."""
        self._on_predict(describe_cells([request.cell for request in requests]))
        yield
        self._on_predict(None)

    def _predict_with_confidence(self, request: PredictionRequest) -> Answer:
        assert isinstance(self._model, ConfidentModel)
        with self._announced(request):
            return predict_with_confidence_checked(self._model, request.frames, describe_cell(*request.cell))

    def _predict_draws(self, request: PredictionRequest) -> Answer:
        """Return the flow of the first draw, with the spread over all draws; draws with the same frames as the first
        are not predicted again."""
        count = len(request.frames) // request.draws
        draws = [request.frames[start : start + count] for start in range(0, len(request.frames), count)]
        first = self._predict_once(replace(request, frames=draws[0]))
        flows = [
            first if all(map(np.array_equal, frames, draws[0])) else self._predict_once(replace(request, frames=frames))
            for frames in draws[1:]
        ]
        return with_spread([first, *flows])

    def _flows(self, requests: Sequence[PredictionRequest]) -> list[Flow]:
        if len(requests) > 1 and requests[0].index is None and isinstance(self._model, BatchedFlowModel):
            cells = [request.cell for request in requests]
            with self._announced(*requests):
                return predict_batch_checked(self._model, [request.frames for request in requests], cells)
        return [self._predict_once(request) for request in requests]

    def _flows_back(self, requests: Sequence[PredictionRequest], flows: Sequence[Flow]) -> list[Flow]:
        """Predict the flows from frame 2 to frame 1; if the frames are equal, the flow is already known."""
        known = [np.array_equal(request.frames[0], request.frames[1]) for request in requests]
        asked = [replace(one, frames=one.frames[1::-1]) for one, same in zip(requests, known, strict=True) if not same]
        back = iter(self._flows(asked))
        return [flow if same else next(back) for flow, same in zip(flows, known, strict=True)]

    def _predict_once(self, request: PredictionRequest) -> Flow:
        with self._announced(request):
            if request.index is not None:
                assert isinstance(self._model, ClipModel)
                return predict_clip_checked(self._model, request.frames, request.index, *request.cell)
            assert isinstance(self._model, FlowModel | FlowLookup)
            return predict_checked(self._model, request.frames, *request.cell)

"""The second stage of a cell: ask the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..models.base import (
    AnyModel,
    BatchedFlowModel,
    ClipModel,
    FlowLookup,
    FlowModel,
    places,
    predict_batch_checked,
    predict_checked,
    predict_clip_checked,
)
from ..sample import Flow
from .question import Question
from .seconds import Seconds, spent


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

    def predict(self, questions: Sequence[Question]) -> list[Flow]:
        """The flows of some cells: several in one call, if the model can; a single one goes through `predict`.

        Raises:
            ModelError: the model raised, or returned something that is not float (H, W, 2).
        """
        with spent(self._seconds, "predict"):
            self._on_predict(places([question.cell for question in questions]))
            if len(questions) > 1 and questions[0].index is None and isinstance(self._model, BatchedFlowModel):
                cells = [question.cell for question in questions]
                flows = predict_batch_checked(self._model, [question.frames for question in questions], cells)
            else:
                flows = [self._one(question) for question in questions]
            self._on_predict(None)
            return flows

    def _one(self, question: Question) -> Flow:
        if question.index is not None:
            assert isinstance(self._model, ClipModel)
            return predict_clip_checked(self._model, question.frames, question.index, *question.cell)
        assert isinstance(self._model, FlowModel | FlowLookup)
        return predict_checked(self._model, question.frames, *question.cell)

"""Load the model of a run once, and keep the name by which worker processes load their copies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.arguments import check_count
from ..core.errors import UsageError
from ..models import ModelSpec
from ..models.base import AnyModel, BatchedFlowModel, ClipModel, FlowLookup, given_name, model_identity
from ..models.loading import as_model
from ..models.provenance import DECLARED, Training, training_of


@dataclass(frozen=True)
class NamedModel:
    """A loaded model."""

    spec: ModelSpec | None
    model: AnyModel
    identity: dict[str, Any]
    declared: str | None
    name: str | None = None

    @property
    def training(self) -> Training:
        """Return the model's training sets; raise a UsageError if a declared set is unknown."""
        return training_of(self.identity, self.declared)

    def check_batch_size(self, size: int) -> None:
        """Raise if the model does not support a batch size."""
        check_count("--batch-size", size)
        if size > 1 and isinstance(self.model, ClipModel):
            raise UsageError("--batch-size", "a multi-frame model predicts one clip at a time; omit it")
        if size > 1 and not isinstance(self.model, BatchedFlowModel):
            raise UsageError("--batch-size", "the model has no method predict_batch; omit it")


def name_model(model: str | Path | ModelSpec | AnyModel | Callable[..., Any]) -> NamedModel:
    """Load a model by name, path or spec, or wrap a model object."""
    if isinstance(model, str | Path):
        model = ModelSpec(str(model))
    if isinstance(model, ModelSpec):
        loaded = model.load()
        declared = dict(model.options).get(DECLARED, getattr(loaded, DECLARED, None))
        own_name = given_name(loaded) if model.is_own else None
        return NamedModel(model, loaded, model.identity(loaded), declared, own_name)
    given = as_model(model, f"the model {model!r}")
    return NamedModel(None, given, model_identity(given), getattr(given, DECLARED, None), given_name(given))


def load_predictor(model: str | Path | ModelSpec | AnyModel) -> NamedModel:
    """Load a model as `name_model` does, and check that it can predict the flow of new frames."""
    named = name_model(model)
    if isinstance(named.model, FlowLookup):
        raise UsageError("--model", "flow files cannot be used to predict new frames")
    return named

"""Flow models: the protocols, the built-in adapters, and loading models by name."""

from __future__ import annotations

from .loading import ModelRef, list_models, load_model
from .objects import FunctionModel
from .protocols import ClipModel, Differentiable, FlowLookup, FlowModel, Window
from .registered import MODELS

__all__ = [
    "MODELS",
    "ClipModel",
    "Differentiable",
    "FlowLookup",
    "FlowModel",
    "FunctionModel",
    "ModelRef",
    "Window",
    "list_models",
    "load_model",
]

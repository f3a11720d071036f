"""Flow models: the protocols, the built-in adapters, and loading models by name."""

from __future__ import annotations

from .base import ClipModel, Differentiable, FlowLookup, FlowModel, Window
from .loading import FunctionModel, ModelSpec, list_models, load_model
from .registry import MODELS

__all__ = [
    "MODELS",
    "ClipModel",
    "Differentiable",
    "FlowLookup",
    "FlowModel",
    "FunctionModel",
    "ModelSpec",
    "Window",
    "list_models",
    "load_model",
]

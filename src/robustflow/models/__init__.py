"""Flow models: the protocol, the built-in adapters, and how a model is found by name."""

from __future__ import annotations

from .base import FlowLookup, FlowModel
from .loading import MODELS, FunctionModel, ModelSpec, load_model

__all__ = ["MODELS", "FlowLookup", "FlowModel", "FunctionModel", "ModelSpec", "load_model"]

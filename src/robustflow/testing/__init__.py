"""Checks for user-defined models, corruptions, attacks and datasets, and small test doubles; all are imported
lazily.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .datasets import TexturePairs, check_dataset
    from .extensions import check_attack, check_corruption
    from .models import BrightnessFlow, ConstantFlow, ShiftedTruth, ZeroClipFlow, ZeroFlow, check_model

__all__ = [
    "BrightnessFlow",
    "ConstantFlow",
    "ShiftedTruth",
    "TexturePairs",
    "ZeroClipFlow",
    "ZeroFlow",
    "check_attack",
    "check_corruption",
    "check_dataset",
    "check_model",
]
_WHERE = {
    "TexturePairs": "datasets",
    "check_dataset": "datasets",
    "check_attack": "extensions",
    "check_corruption": "extensions",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f".{_WHERE.get(name, 'models')}", __name__), name)

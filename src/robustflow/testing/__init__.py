"""Checks for user-defined models, corruptions, attacks and datasets, and small test doubles."""

from .datasets import TexturePairs, check_dataset
from .extensions import check_attack, check_corruption
from .models import BrightnessFlow, ConstantFlow, ZeroClipFlow, ZeroFlow, check_model

__all__ = [
    "BrightnessFlow",
    "ConstantFlow",
    "TexturePairs",
    "ZeroClipFlow",
    "ZeroFlow",
    "check_attack",
    "check_corruption",
    "check_dataset",
    "check_model",
]

"""The corruptions from the paper (appendix "Corruption Details"), each with a `draw` and an `apply` method."""

from __future__ import annotations

from ..core.arguments import SEVERITIES
from .api import corrupt, corrupt_clip, corruption_name, corruption_names, list_corruptions, load_corruption
from .corruption import Corruption, DepthCorruption
from .registry import CLIP, CORRUPTIONS, FAMILIES, IMAGE_PAIR, PAPER_ORDER

__all__ = [
    "CLIP",
    "CORRUPTIONS",
    "FAMILIES",
    "IMAGE_PAIR",
    "PAPER_ORDER",
    "SEVERITIES",
    "Corruption",
    "DepthCorruption",
    "corrupt",
    "corrupt_clip",
    "corruption_name",
    "corruption_names",
    "list_corruptions",
    "load_corruption",
]

"""Reject invalid models by their name and options before any heavy library is imported."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..extras import require
from ..layout import user_path
from .catalog import is_in_ptlflow, methods, published_names
from .model_file import require_file
from .networks.table import NETWORKS
from .ptlflow.pairs import BESIDES
from .registry import EXPORTED
from .torch.find_checkpoint import SOURCES, needs_checkpoint, refuse_missing_file


def preflight(name: str, options: Mapping[str, Any]) -> None:
    """Raise an error if a model's file, library or checkpoint is missing."""
    checkpoint, method = options.get("checkpoint"), methods().get(name)
    if method is None:
        if Path(name).suffix.lower() in EXPORTED:
            require_file(user_path(name), "file; pass the path of the exported network")
            require("onnxruntime", f"model '{name}'")
        if not is_in_ptlflow(name):
            return
    library = "ptlflow" if method is None else method.source
    source = NETWORKS[name].source if name in NETWORKS else SOURCES.get(library)
    if source is None:
        return
    names = published_names(name)
    refuse_missing_file(name, checkpoint, names, source, strict=False)
    require(library if library in SOURCES else "torch", f"model '{name}'")
    if checkpoint is None and name not in BESIDES:
        raise needs_checkpoint(name, names, source)

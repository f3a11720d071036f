"""Metadata of the methods and their public checkpoints, from `methods.csv` and `checkpoints.csv`.

The training sets of the checkpoints were taken from the authors' code, documentation and replies to users. A question
mark denotes a dataset that may have been used for training: `kitti2015?`.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from typing import Literal

from pydantic import Field

from ...core.types import Frozen

PTLFLOW = "ptlflow:"
"""Prefix for ptlflow's models whose plain names mean others here: `raft` runs 12 iterations, `ptlflow:raft` 32."""

_ADDRESSES = {
    "ptlflow": "https://github.com/hmorimitsu/ptlflow/releases/download/weights1/",
    "torchvision": "https://download.pytorch.org/models/",
}
"""Base URLs of the checkpoints published by the libraries."""


class MethodEntry(Frozen):
    """A method that can be loaded by name."""

    model: str
    method: str
    year: int = Field(ge=1980, le=2100)
    type: Literal["knowledge", "supervised", "unsupervised"]
    source: Literal["OpenCV", "ptlflow", "torchvision", "own"]
    extra: Literal["", "torch", "ptlflow"]
    code_licence: str
    frames: int = Field(default=2, ge=2)


class CheckpointEntry(Frozen):
    """A public checkpoint."""

    model: str
    checkpoint: str
    file: str
    sha256: str = Field(pattern="^[0-9a-f]{8}$")
    trained_on: str = Field(pattern=r"^[a-z0-9+?-]+$")
    backbone: str = Field(pattern=r"^[a-z0-9-]*[?]?$")
    confidence: Literal["high", "medium", "low"]
    note: str

    @property
    def address(self) -> str:
        """The URL where the file is published."""
        method = methods().get(self.model)
        return _ADDRESSES["ptlflow" if method is None else method.source] + self.file


@cache
def methods() -> dict[str, MethodEntry]:
    """Return the methods, keyed by the name used to load them."""
    return {entry.model: entry for entry in map(MethodEntry.model_validate, _lines("methods"))}


@cache
def checkpoints() -> tuple[CheckpointEntry, ...]:
    """Return all known public checkpoints."""
    return tuple(map(CheckpointEntry.model_validate, _lines("checkpoints")))


def entries_of(model: str) -> list[CheckpointEntry]:
    """Return the public checkpoints of a model; `ptlflow:NAME` has those of NAME unless both have entries."""
    named = [entry for entry in checkpoints() if entry.model == model]
    return named or [entry for entry in checkpoints() if entry.model == model.removeprefix(PTLFLOW)]


def is_in_ptlflow(model: str) -> bool:
    """Return whether an unregistered name is a ptlflow model with public checkpoints.

    >>> is_in_ptlflow("sea_raft_m"), is_in_ptlflow("dis")
    (True, False)
    """
    return model not in methods() and any(entry.model == model for entry in checkpoints())


def published_names(model: str) -> list[str]:
    """Return the names of a model's public checkpoints in the catalogue.

    >>> published_names("raft_small")
    ['C_T_V1', 'C_T_V2']
    """
    return [entry.checkpoint for entry in entries_of(model)]


def is_installed(method: MethodEntry) -> bool:
    """Return whether the libraries that a method needs are installed."""
    return not method.extra or find_spec({"own": "torch"}.get(method.source, method.source)) is not None


def _lines(table: str) -> list[dict[str, str]]:
    return list(csv.DictReader((files(__package__) / f"{table}.csv").read_text(encoding="utf-8").splitlines()))

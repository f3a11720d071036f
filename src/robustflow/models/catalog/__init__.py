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

from ...validated import Frozen

PTLFLOW = "ptlflow:"
"""Prefix for ptlflow models whose plain names refer to a different model here: `raft` runs 12 iterations as in the
paper, `ptlflow:raft` runs the library's 32; `raft_small` is torchvision's model.
"""

_ADDRESSES = {
    "ptlflow": "https://github.com/hmorimitsu/ptlflow/releases/download/weights1/",
    "torchvision": "https://download.pytorch.org/models/",
}
"""Base URLs of the checkpoints published by the libraries."""


class MethodEntry(Frozen):
    """A method that can be loaded by name.

    Attributes:
        model: name by which the method is loaded.
        method: unique label in tables, figures and pages, as in the method's paper. `dis` is OpenCV's widely used DIS
            on greyscale frames; `dis_rgb` is DIS-RGB, the version that the benchmark's paper calls DIS.
        year: year of publication.
        type: basis of the method: prior knowledge, supervised training or unsupervised training.
        source: origin of the implementation: a library or this project.
        extra: pip extra that the method requires; "" if none.
        frames: maximum number of input frames: 2 for a two-frame method, more for a multi-frame method.
        code_licence: licence of the implementation; most published weights have no licence.
    """

    model: str
    method: str
    year: int = Field(ge=1980, le=2100)
    type: Literal["knowledge", "supervised", "unsupervised"]
    source: Literal["OpenCV", "ptlflow", "torchvision", "own"]
    extra: Literal["", "torch", "ptlflow"]
    code_licence: str
    frames: int = Field(default=2, ge=2)


class CheckpointEntry(Frozen):
    """A public checkpoint.

    Attributes:
        model: name of the checkpoint's model; `ptlflow:NAME` if NAME alone refers to a model of a different
            library.
        checkpoint: name of the checkpoint.
        file: name of the file.
        sha256: first eight hexadecimal digits of the file's SHA-256.
        trained_on: training sets, named as in `provenance.TRAINING_SETS` and separated by "+"; "?" denotes a dataset
            that may have been used.
        backbone: pre-trained network that the model contains, or the data on which it was pre-trained; "?" denotes
            pre-training on data that were not checked; "" if none is known.
        confidence: confidence in `trained_on`: "high" if it is stated in the authors' code, documentation or replies;
            "medium" if it is inferred from their naming, from a reproduction by others, or from a matching accuracy;
            "low" if it is not documented.
        note: evidence for `trained_on`, and remaining uncertainties.
    """

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
        """The URL where the file is published.

        >>> checkpoints()[0].address
        'https://github.com/hmorimitsu/ptlflow/releases/download/weights1/raft-chairs-590f38f7.ckpt'
        """
        method = methods().get(self.model)
        return _ADDRESSES["ptlflow" if method is None else method.source] + self.file


@cache
def methods() -> dict[str, MethodEntry]:
    """Return the methods, keyed by the name used to load them.

    >>> methods()["flowformer_pp"].method
    'FlowFormer++'
    """
    return {entry.model: entry for entry in map(MethodEntry.model_validate, _lines("methods"))}


@cache
def checkpoints() -> tuple[CheckpointEntry, ...]:
    """Return all known public checkpoints.

    >>> [entry.checkpoint for entry in checkpoints() if entry.model == "csflow"]
    ['chairs', 'things', 'kitti']
    """
    return tuple(map(CheckpointEntry.model_validate, _lines("checkpoints")))


def entries_of(model: str) -> list[CheckpointEntry]:
    """Return the public checkpoints of a model; `ptlflow:NAME` has the same ones as NAME, unless NAME refers to a
    different library's model.

    >>> entries_of("ptlflow:raft") == entries_of("raft"), entries_of("ptlflow:raft_small") == entries_of("raft_small")
    (True, False)
    """
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
    """Return whether the libraries that a method needs are installed.

    >>> is_installed(methods()["dis"])
    True
    """
    return not method.extra or find_spec({"own": "torch"}.get(method.source, method.source)) is not None


def _lines(table: str) -> list[dict[str, str]]:
    return list(csv.DictReader((files(__package__) / f"{table}.csv").read_text(encoding="utf-8").splitlines()))

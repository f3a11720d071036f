"""Facts about the methods and their public checkpoints, as data: `methods.csv` and `checkpoints.csv`.

The training sets of a checkpoint are what its authors' code, documentation and answers say. A set that it may have seen
has a question mark: `kitti2015?`.
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
"""Prefix of ptlflow's models whose names mean something else here: `raft` takes the paper's 12 iterations,
`ptlflow:raft` the library's 32; `raft_small` is torchvision's."""

_ADDRESSES = {
    "ptlflow": "https://github.com/hmorimitsu/ptlflow/releases/download/weights1/",
    "torchvision": "https://download.pytorch.org/models/",
}
"""Base addresses of the libraries' published checkpoints."""


class MethodEntry(Frozen):
    """A method that can be loaded by name.

    Attributes:
        model: the name by which it is loaded.
        method: its label in tables, figures and pages: that of its paper, and unique. `dis` is the DIS that most people
            know, OpenCV's on grey frames; `dis_rgb` is DIS-RGB, the version that the benchmark's paper calls DIS.
        year: of its publication.
        type: what it was made from: prior knowledge, or training with or without labels.
        source: whose implementation runs: a library's, or the project's own.
        extra: the extra of the installation that it needs, "" for none.
        frames: the largest number that it is given: 2, or more for a multi-frame method.
        code_licence: of that implementation; hardly any weights state one.
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
        model: the name of the model it is for; `ptlflow:NAME` where NAME is a different library's model.
        checkpoint: its name.
        file: its file's name.
        sha256: the first eight digits of the file's hash.
        trained_on: training sets, in the words of `provenance.TRAINING_SETS`, separated by "+"; one that it may have
            seen ends in "?".
        confidence: of `trained_on`: "high" for the authors' code, documentation or answer; "medium" for their naming, a
            reproduction by others, or an accuracy that fits; "low" if it is not documented.
        note: the evidence, and what is uncertain.
    """

    model: str
    checkpoint: str
    file: str
    sha256: str = Field(pattern="^[0-9a-f]{8}$")
    trained_on: str = Field(pattern=r"^[a-z0-9+?-]+$")
    confidence: Literal["high", "medium", "low"]
    note: str

    @property
    def address(self) -> str:
        """Where the file is published.

        >>> checkpoints()[0].address
        'https://github.com/hmorimitsu/ptlflow/releases/download/weights1/raft-chairs-590f38f7.ckpt'
        """
        method = methods().get(self.model)
        return _ADDRESSES["ptlflow" if method is None else method.source] + self.file


@cache
def methods() -> dict[str, MethodEntry]:
    """Methods by the name used to load them.

    >>> methods()["flowformer_pp"].method
    'FlowFormer++'
    """
    return {entry.model: entry for entry in map(MethodEntry.model_validate, _lines("methods"))}


@cache
def checkpoints() -> tuple[CheckpointEntry, ...]:
    """Every public checkpoint known.

    >>> [entry.checkpoint for entry in checkpoints() if entry.model == "csflow"]
    ['chairs', 'things', 'kitti']
    """
    return tuple(map(CheckpointEntry.model_validate, _lines("checkpoints")))


def entries_of(model: str) -> list[CheckpointEntry]:
    """The public checkpoints of a model; `ptlflow:NAME` has those of NAME, unless NAME is a different library's model.

    >>> entries_of("ptlflow:raft") == entries_of("raft"), entries_of("ptlflow:raft_small") == entries_of("raft_small")
    (True, False)
    """
    named = [entry for entry in checkpoints() if entry.model == model]
    return named or [entry for entry in checkpoints() if entry.model == model.removeprefix(PTLFLOW)]


def is_in_ptlflow(model: str) -> bool:
    """Whether a name that is not registered is one of ptlflow's models with public checkpoints.

    >>> is_in_ptlflow("sea_raft_m"), is_in_ptlflow("dis")
    (True, False)
    """
    return model not in methods() and any(entry.model == model for entry in checkpoints())


def published_names(model: str) -> list[str]:
    """Names of the public checkpoints of a model in the catalogue.

    >>> published_names("raft_small")
    ['C_T_V1', 'C_T_V2']
    """
    return [entry.checkpoint for entry in entries_of(model)]


def is_installed(method: MethodEntry) -> bool:
    """Whether the libraries that a method needs are installed.

    >>> is_installed(methods()["dis"])
    True
    """
    return not method.extra or find_spec({"own": "torch"}.get(method.source, method.source)) is not None


def _lines(table: str) -> list[dict[str, str]]:
    return list(csv.DictReader((files(__package__) / f"{table}.csv").read_text(encoding="utf-8").splitlines()))

"""Determine a model's training sets; `benchmarks/setting.py` defines their consequences for results on a benchmark."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ..core.errors import UsageError, unknown_name
from ..core.types import Untrusted
from .catalog import CheckpointEntry, entries_of, methods
from .torch.build import RANDOM

Setting = Literal["knowledge", "OOD", "ID", "LEAKED", "untrained", "UNKNOWN"]

TRAINING_SETS = {
    "C": "flyingchairs",
    "T": "flyingthings3d",
    "S": "sintel",
    "K": "kitti2015",
    "K12": "kitti2012",
    "VK": "virtual-kitti",
    "KR": "kitti-raw",
    "H": "hd1k",
    "SP": "spring",
    "TA": "tartanair",
    "V": "viper",
    "A": "autoflow",
    "M": "middlebury",
    "G": "gopro",
    "YT": "youtube-vos",
    "FS": "shapes",
    "IN": "imagenet",
    "X": "other",
}
"""Training sets, keyed by their abbreviations in the literature. `SET:train` is the part that a benchmark does
not use for evaluation (see `PARTS`); `SET?` is a dataset that may have been used; "other" stands for any data that
shares neither frames nor scenes with a benchmark.
"""

DECLARED = "trained_on"
"""Name of the option of every model, and of the attribute of a user's model, that declares the training sets."""

PARTS = {"kitti2015": ("train", "drive-disjoint", "released")}
"""Parts that a declaration `SET:PART` may name: of the project's split, the drive-disjoint one, released KITTI-FC."""

KNOWLEDGE = "method"
"""Value of `basis` for a method without learning."""


class Training(Untrusted):
    """The training sets of a model, as a run's manifest stores them: their names, the evidence for them, and the
    pre-trained backbone."""

    sets: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(max_length=100)] | None
    basis: Annotated[str, Field(min_length=1)]
    note: str = ""
    backbone: str = ""

    @property
    def trained(self) -> bool:
        """Return whether the model learned from data."""
        return self.basis not in (RANDOM, KNOWLEDGE)


UNDECLARED = Training(sets=None, basis="undeclared")
"""The training of a model about which nothing is known."""


def training_of(identity: Mapping[str, Any], declared: str | None = None) -> Training:
    """Return a model's training sets from its identity."""
    sets = parse_training_sets(declared) if declared is not None else None
    name, digest = str(identity.get("name")), str(identity.get("checkpoint", ""))
    method = methods().get(name)
    if digest == RANDOM:
        return Training(sets=None, basis=RANDOM)
    if method is not None and method.type == "knowledge":
        return Training(sets=None, basis=KNOWLEDGE)
    for entry in entries_of(name):
        if re.fullmatch("[0-9a-f]{64}", digest) and digest.startswith(entry.sha256):
            return training_of_entry(entry)
    if sets is not None:
        return Training(sets=sets, basis="declared")
    return UNDECLARED


def training_of_entry(entry: CheckpointEntry) -> Training:
    """Return the training sets of a checkpoint in the catalogue."""
    basis = f"catalog: {entry.model} {entry.checkpoint}"
    return Training(sets=tuple(entry.trained_on.split("+")), basis=basis, note=entry.note, backbone=entry.backbone)


def parse_training_sets(text: str) -> tuple[str, ...]:
    """Parse training sets written in the notation used in the literature."""
    sets: list[str] = []
    for part in re.split(r"[+>,\s]+", str(text).strip()):
        certain = part.removesuffix("?")
        name, colon, which = certain.partition(":")
        training_set = TRAINING_SETS.get(name.upper(), name.lower())
        if training_set not in TRAINING_SETS.values():
            raise unknown_name("training set", name, [*TRAINING_SETS.values(), *TRAINING_SETS])
        parts = PARTS.get(training_set, ("train",))
        if colon and which not in parts:
            raise UsageError(
                part, f"unknown part of a training set; the parts of {training_set} are {', '.join(parts)}"
            )
        sets.append(training_set + colon + which + part[len(certain) :])
    return tuple(dict.fromkeys(sets))

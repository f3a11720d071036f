"""What a model was trained on; what that means for its numbers on a benchmark is in `benchmarks/setting.py`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from ..errors import UsageError, unknown_name
from .catalog import CheckpointEntry, entries_of, methods
from .torch.find_checkpoint import RANDOM

Setting = Literal["knowledge", "OOD", "ID", "LEAKED", "untrained", "UNKNOWN"]

TRAINING_SETS = {
    "C": "flyingchairs",
    "T": "flyingthings3d",
    "S": "sintel",
    "K": "kitti2015",
    "K12": "kitti2012",
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
"""Training sets by their letters in the literature. `SET:train` is the part that a benchmark does not evaluate (see
`PARTS`), `SET?` one that may have been used; "other" is anything that shares no frames and no scenes with any
benchmark."""

DECLARED = "trained_on"
"""The option of every model, and the attribute of a user's model, that declares its training sets."""

PARTS = {"kitti2015": ("train", "drive-disjoint", "released")}
"""The parts of a training set that a declaration may name, `SET:PART`, where there are more than "train": the training
part of the project's split, of its drive-disjoint split, or of the released KITTI-FC."""

KNOWLEDGE = "method"
"""The basis of a method that learns nothing."""


@dataclass(frozen=True)
class Training:
    """What a model was trained on.

    Attributes:
        sets: names among `TRAINING_SETS`, perhaps with a part (one of `PARTS`, as ":train"), or with "?" if it may have
            been used; None if unknown.
        basis: how that is known.
        note: what is uncertain.
        trained: False for methods that learn nothing and for random weights.
    """

    sets: tuple[str, ...] | None
    basis: str
    note: str = ""
    trained: bool = True


def training_of(identity: Mapping[str, Any], declared: str | None = None) -> Training:
    """What a model was trained on, by its identity.

    A checkpoint of the catalogue is recognised by the hash of its file, wherever it is and whatever is declared.

    Args:
        identity: of the model: `name`, `checkpoint`.
        declared: training sets as the user declared them, see `parse_training_sets`.

    >>> training_of({"name": "dis"}).trained, training_of({"name": "mine"}).basis
    (False, 'undeclared')
    >>> training_of({"name": "mine"}, "C+T").sets
    ('flyingchairs', 'flyingthings3d')
    """
    sets = parse_training_sets(declared) if declared is not None else None
    name, digest = str(identity.get("name")), str(identity.get("checkpoint", ""))
    method = methods().get(name)
    if digest == RANDOM:
        return Training(None, RANDOM, trained=False)
    if method is not None and method.type == "knowledge":
        return Training(None, KNOWLEDGE, trained=False)
    for entry in entries_of(name):
        if re.fullmatch("[0-9a-f]{64}", digest) and digest.startswith(entry.sha256):
            return training_of_entry(entry)
    if sets is not None:
        return Training(sets, "declared")
    return Training(None, "undeclared")


def training_of_entry(entry: CheckpointEntry) -> Training:
    """What a checkpoint of the catalogue was trained on."""
    return Training(tuple(entry.trained_on.split("+")), f"catalog: {entry.model} {entry.checkpoint}", entry.note)


def parse_training_sets(text: str) -> tuple[str, ...]:
    """Training sets as the literature writes them.

    >>> parse_training_sets("C+T>K:train")
    ('flyingchairs', 'flyingthings3d', 'kitti2015:train')
    >>> parse_training_sets("C+T+K?")
    ('flyingchairs', 'flyingthings3d', 'kitti2015?')
    >>> parse_training_sets("Sintel, other")
    ('sintel', 'other')

    Raises:
        UsageError: nothing is declared, or an unknown set.
    """
    sets: list[str] = []
    for part in re.split(r"[+>,\s]+", str(text).strip()):
        certain = part.removesuffix("?")
        name, colon, which = certain.partition(":")
        known = TRAINING_SETS.get(name.upper(), name.lower())
        if known not in TRAINING_SETS.values():
            raise unknown_name("training set", name, [*TRAINING_SETS.values(), *TRAINING_SETS])
        parts = PARTS.get(known, ("train",))
        if colon and which not in parts:
            raise UsageError(
                f"unknown part of a training set in '{part}': write {known}, or {known}:train for what is not "
                f"evaluated; parts of it are {', '.join(parts)}"
            )
        sets.append(known + colon + which + part[len(certain) :])
    return tuple(dict.fromkeys(sets))

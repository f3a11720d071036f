"""What a model has seen, and what that makes of its numbers: out of domain, in domain, or leaked."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from ..errors import UsageError, unknown_name
from .catalog import CheckpointEntry, checkpoints, methods
from .torch.find_checkpoint import RANDOM

Setting = Literal["knowledge", "OOD", "ID", "LEAKED", "untrained", "undeclared"]

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
    "IN": "imagenet",
    "X": "other",
}
"""Training sets by the letters of the literature. `SET:train` is the part that a benchmark does not evaluate; "other"
is anything that shares no frames and no scenes with any benchmark."""

DECLARED = "trained_on"
"""The option of every model, and the attribute of a user's own, that declares its training sets."""

_SEEN = {
    "kitti-fc": ("kitti2015", ("kitti2012", "kitti-raw")),
    "kitti2015": ("kitti2015", ("kitti2012", "kitti-raw")),
    "kitti2012": ("kitti2012", ("kitti2015", "kitti-raw")),
    "gopro-fc": ("gopro", ()),
    "gopro": ("gopro", ()),
    "demo": ("middlebury", ()),
    "motorcycle": ("middlebury", ()),
}
"""For a benchmark: the training set its frames come from, and others of the same domain."""

_OWN_FRAMES = ("folder",)


@dataclass(frozen=True)
class Training:
    """What a model was trained on.

    Attributes:
        sets: names among `TRAINING_SETS`, perhaps with ":train"; None where nobody said.
        basis: how that is known.
        note: what is not certain.
        trained: False for methods that learn nothing and for random weights.
    """

    sets: tuple[str, ...] | None
    basis: str
    note: str = ""
    trained: bool = True

    def setting(self, benchmark: str) -> Setting:
        """What the numbers of this model on a benchmark are worth.

        "OOD": saw nothing of its domain. "ID": saw its domain, and none of the frames it evaluates. "LEAKED": saw the
        frames it evaluates. "knowledge": learns nothing. "untrained": random weights. "undeclared": nobody said, or
        the frames are the user's own.

        >>> Training(("flyingchairs", "kitti2015"), "declared").setting("kitti-fc")
        'LEAKED'
        >>> Training(("flyingchairs", "kitti2015:train"), "declared").setting("kitti-fc")
        'ID'
        >>> Training(("kitti2015",), "declared").setting("gopro-fc")
        'OOD'
        """
        if not self.trained:
            return "untrained" if self.basis == RANDOM else "knowledge"
        if self.sets is None or benchmark in _OWN_FRAMES:
            return "undeclared"
        evaluated, related = _SEEN.get(benchmark, (benchmark, ()))
        if evaluated in self.sets:
            return "LEAKED"
        return (
            "ID" if {f"{evaluated}:train", *related, *(f"{name}:train" for name in related)} & {*self.sets} else "OOD"
        )

    def record(self, benchmark: str) -> dict[str, Any]:
        """For a run's manifest."""
        sets = None if self.sets is None else list(self.sets)
        about = {"setting": self.setting(benchmark), "trained_on": sets, "basis": self.basis}
        return about | ({"note": self.note} if self.note else {})


def training_of(identity: Mapping[str, Any], declared: str | None = None) -> Training:
    """What the model of an identity was trained on.

    A checkpoint of the catalog is known by the hash of its file, wherever it lies and whatever is declared.

    Args:
        identity: of the model: `name`, `checkpoint`.
        declared: training sets in the words of the user, see `parse_training_sets`.

    >>> training_of({"name": "dis"}).setting("kitti-fc")
    'knowledge'
    >>> training_of({"name": "mine"}).setting("kitti-fc")
    'undeclared'
    >>> training_of({"name": "mine"}, "C+T").setting("kitti-fc")
    'OOD'
    """
    said = parse_training_sets(declared) if declared is not None else None
    name, digest = str(identity.get("name")), str(identity.get("checkpoint", ""))
    method = methods().get(name)
    if digest == RANDOM:
        return Training(None, RANDOM, trained=False)
    if method is not None and method.type == "knowledge":
        return Training(None, "method", trained=False)
    for entry in checkpoints():
        if entry.model == name and re.fullmatch("[0-9a-f]{64}", digest) and digest.startswith(entry.sha256):
            return training_of_entry(entry)
    if said is not None:
        return Training(said, "declared")
    return Training(None, "undeclared")


def training_of_entry(entry: CheckpointEntry) -> Training:
    """What a checkpoint of the catalog was trained on."""
    return Training(tuple(entry.trained_on.split("+")), f"catalog: {entry.model} {entry.checkpoint}", entry.note)


def parse_training_sets(text: str) -> tuple[str, ...]:
    """Training sets as the literature writes them.

    >>> parse_training_sets("C+T>K:train")
    ('flyingchairs', 'flyingthings3d', 'kitti2015:train')
    >>> parse_training_sets("Sintel, other")
    ('sintel', 'other')

    Raises:
        UsageError: nothing, or a set that is not known, whose consequence nobody could tell.
    """
    found: list[str] = []
    for part in re.split(r"[+>,\s]+", str(text).strip()):
        name, colon, which = part.partition(":")
        known = TRAINING_SETS.get(name.upper(), name.lower())
        if known not in TRAINING_SETS.values():
            raise unknown_name("training set", name, [*TRAINING_SETS.values(), *TRAINING_SETS])
        if colon and which != "train":
            raise UsageError(f"'{part}' is no training set: write {known}, or {known}:train for what is not evaluated")
        found.append(known + (":train" if colon else ""))
    return tuple(dict.fromkeys(found))

"""Which samples are evaluated and which are left for training.

The paper evaluates 80 of KITTI's 200 training pairs and fine-tunes on the other 120; its list is an unseeded random
sample. Ours is reproducible: every key is hashed together with the seed, and the 80 smallest hashes are evaluated. A
pair's rank does not depend on which other pairs exist, or on their order.

Four of five evaluated pairs whose drive is known have a training pair from the same drive, often a second away, so a
model trained on the 120 is measured on near duplicates of its training data (the paper's split, drawn pair by pair,
cannot be better). `drive_disjoint_split` has the same number of pairs, and no drive on both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from ..errors import DataError, UsageError
from ..random.rng import key_of
from .kitti_drives import drive_groups

KITTI_SPLIT_SEED = 0
"""The seed of the project's KITTI split. It is not the run's seed: another run seed keeps the same pairs."""

DRIVE_DISJOINT = "drive-disjoint"
"""The value of `--split` for `drive_disjoint_split`."""

KITTI_KEYS = tuple(f"{number:06d}" for number in range(200))
"""The keys of all pairs of KITTI 2015."""

_EVALUATED = 80


class Split(NamedTuple):
    """Keys to evaluate and keys to train on, each in the order of the data set."""

    evaluation: list[str]
    training: list[str]


def kitti_split(keys: Sequence[str], seed: int = KITTI_SPLIT_SEED) -> Split:
    """80 pairs to evaluate and the rest to train on; if there are fewer than 200 pairs, all are evaluated.

    >>> keys = [f"{number:06d}" for number in range(200)]
    >>> split = kitti_split(keys)
    >>> len(split.evaluation), len(split.training)
    (80, 120)
    >>> kitti_split(keys[:3]).evaluation
    ['000000', '000001', '000002']
    """
    if len(keys) < len(KITTI_KEYS):
        return Split(list(keys), [])
    ranked = sorted(keys, key=lambda key: (key_of("kitti-split", seed, key), key))
    chosen = set(ranked[:_EVALUATED])
    return Split([key for key in keys if key in chosen], [key for key in keys if key not in chosen])


def drive_disjoint_split(keys: Sequence[str], seed: int = KITTI_SPLIT_SEED) -> Split:
    """80 pairs to evaluate and 120 to train on, with no drive of KITTI 2015 on both sides.

    Whole drives, and whole runs of pairs without a drive (see `kitti_drives`), are taken in the order of their hashes,
    each if it still fits, until there are 80 pairs. In a folder with fewer than 200 pairs, the existing ones are on
    their usual side.

    >>> keys = [f"{number:06d}" for number in range(200)]
    >>> split = drive_disjoint_split(keys)
    >>> len(split.evaluation), len(split.training)
    (80, 120)
    >>> groups = drive_groups("kitti2015")
    >>> {groups[key] for key in split.evaluation} & {groups[key] for key in split.training}
    set()
    """
    groups = drive_groups("kitti2015")
    pairs: dict[str, list[str]] = {}
    for key, group in groups.items():
        pairs.setdefault(group, []).append(key)
    chosen: set[str] = set()
    for group in sorted(pairs, key=lambda name: (key_of("kitti-drive-split", seed, name), name)):
        if len(chosen) + len(pairs[group]) <= _EVALUATED:
            chosen.update(pairs[group])
    return Split([key for key in keys if key in chosen], [key for key in keys if key not in chosen])


KITTI_SPLITS: Mapping[str, Callable[[Sequence[str]], Split]] = {
    "train": kitti_split,
    DRIVE_DISJOINT: drive_disjoint_split,
}
"""The splits of KITTI 2015 by the name of their training part in a declaration of training sets: `K:train`."""


def selected(split: str | Path, keys: Sequence[str], dataset: str) -> list[str]:
    """The keys that `--split` selects, in the order of the data set: those of a named split, or of a file.

    Args:
        split: "drive-disjoint", or a file as for `read_split`.
        keys: of the data set.
        dataset: its name.

    Raises:
        UsageError: a named split of another data set.
        DataError: as for `read_split`, or none of the named split's pairs exists.
    """
    if str(split) != DRIVE_DISJOINT:
        return read_split(split, keys)
    if dataset != "kitti2015":
        raise UsageError(
            f"--split {DRIVE_DISJOINT} is a split of KITTI 2015, not of {dataset}; leave it out, or name a file with "
            "one key per line"
        )
    chosen = drive_disjoint_split(keys).evaluation
    if not chosen:
        raise DataError(f"--split {DRIVE_DISJOINT} evaluates none of these {len(keys)} pairs; leave it out")
    return chosen


def read_split(path: str | Path, keys: Sequence[str]) -> list[str]:
    """The keys that a file selects, in the order of the data set.

    The file holds one key per line, or, as KITTI's own lists do, a 0 or 1 for every pair in order, where 1 means
    evaluate. Empty lines and lines that begin with # are ignored.

    Raises:
        DataError: no such file, an unknown or repeated key, a list of another length, or nothing selected.
    """
    path = Path(path).expanduser()
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise DataError(f"{path}: cannot be read as a split ({reason}); give a text file, one key per line") from error
    lines = [line.strip() for line in text.splitlines()]
    entries = [line for line in lines if line and not line.startswith("#")]
    if entries and set(entries) <= {"0", "1"} and not set(entries) <= set(keys):
        if len(entries) != len(keys):
            raise DataError(f"{path}: {len(entries)} zeros and ones for {len(keys)} pairs; give one per pair")
        chosen = {key for key, mark in zip(keys, entries, strict=True) if mark == "1"}
    else:
        chosen = _listed(path, entries, keys)
    if not chosen:
        raise DataError(f"{path}: selects no sample; list one key per line, for example {keys[0]}")
    return [key for key in keys if key in chosen]


def _listed(path: Path, entries: list[str], keys: Sequence[str]) -> set[str]:
    known, chosen = set(keys), set[str]()
    for entry in entries:
        if entry not in known:
            close = get_close_matches(entry, keys, n=1) or [keys[0]]
            missing = sum(other not in known for other in entries)
            raise DataError(
                f"{path}: no sample '{entry}' in the dataset ({missing} of {len(entries)} are unknown); "
                f"did you mean '{close[0]}'?"
            )
        if entry in chosen:
            raise DataError(f"{path}: '{entry}' is listed twice; list every key once")
        chosen.add(entry)
    return chosen

"""Select the samples for evaluation and for training.

The paper evaluates 80 of KITTI's 200 training pairs and fine-tunes on the other 120; its list is an unseeded random
sample. Our split is reproducible: every key is hashed together with the seed, and the pairs with the 80 smallest hashes
are evaluated. The hash of a pair does not depend on which other pairs exist, or on their order.

Four in five evaluated pairs with a known drive have a training pair from the same drive, often only a second apart, so
a model trained on the 120 pairs is evaluated on near duplicates of its training data. The paper's split is also drawn
pair by pair, and has the same problem. `drive_disjoint_split` has the same number of pairs, but no drive occurs in both
parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from ...core.errors import DataError, UsageError
from ...core.files import read_bounded
from ...core.paths import user_path
from ...core.rng import key_of
from .kitti import drive_groups

KITTI_SPLIT_SEED = 0
"""The seed of the project's KITTI split. It is independent of the run's seed, which does not change the pairs."""

DRIVE_DISJOINT = "drive-disjoint"
"""The value of `--split` that selects `drive_disjoint_split`."""

KITTI_KEYS = tuple(f"{number:06d}" for number in range(200))
"""The keys of all pairs of KITTI 2015."""

_EVALUATED = 80
_LARGEST = 16 * 2**20


class Split(NamedTuple):
    """Keys for evaluation and keys for training, both in the order of the dataset."""

    evaluation: list[str]
    training: list[str]


def kitti_split(keys: Sequence[str], seed: int = KITTI_SPLIT_SEED) -> Split:
    """Return 80 pairs for evaluation and the rest for training; if there are fewer than 200 pairs, all are
    evaluated.
    """
    if len(keys) < len(KITTI_KEYS):
        return Split(list(keys), [])
    ranked = sorted(keys, key=lambda key: (key_of("kitti-split", seed, key), key))
    chosen = set(ranked[:_EVALUATED])
    return Split([key for key in keys if key in chosen], [key for key in keys if key not in chosen])


def drive_disjoint_split(keys: Sequence[str], seed: int = KITTI_SPLIT_SEED) -> Split:
    """Return 80 pairs for evaluation and 120 for training, with no drive of KITTI 2015 in both parts."""
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
"""The splits of KITTI 2015, by the name of their training part in declarations of training sets, such as `K:train`."""


def selected(split: str | Path, keys: Sequence[str], dataset: str) -> list[str]:
    if str(split) != DRIVE_DISJOINT:
        return read_split(split, keys)
    if dataset != "kitti2015":
        raise UsageError("--split", f"{DRIVE_DISJOINT} is a split of KITTI 2015, not of {dataset}; give a file of keys")
    chosen = drive_disjoint_split(keys).evaluation
    if not chosen:
        raise DataError("--split", f"{DRIVE_DISJOINT} evaluates none of these {len(keys)} pairs; leave it out")
    return chosen


def read_split(path: str | Path, keys: Sequence[str]) -> list[str]:
    """Return the keys that a file selects, in the order of the dataset."""
    path = user_path(path)
    advice = "give a text file, one key per line"
    try:
        text = read_bounded(path, _LARGEST, advice).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, f"cannot be read as a split (not a text file); {advice}") from error
    lines = [line.strip() for line in text.splitlines()]
    entries = [line for line in lines if line and not line.startswith("#")]
    if entries and set(entries) <= {"0", "1"} and not set(entries) <= set(keys):
        if len(entries) != len(keys):
            raise DataError(path, f"{len(entries)} zeros and ones for {len(keys)} pairs; give one per pair")
        chosen = {key for key, mark in zip(keys, entries, strict=True) if mark == "1"}
    else:
        chosen = _listed(path, entries, keys)
    if not chosen:
        raise DataError(path, f"selects no sample; list one key per line, for example {keys[0]}")
    return [key for key in keys if key in chosen]


def _listed(path: Path, entries: list[str], keys: Sequence[str]) -> set[str]:
    existing, chosen = set(keys), set[str]()
    for entry in entries:
        if entry not in existing:
            close = get_close_matches(entry, keys, n=1) or [keys[0]]
            lost = f"{sum(other not in existing for other in entries)} of {len(entries)} are unknown"
            raise DataError(path, f"no sample '{entry}' in the dataset ({lost}); did you mean '{close[0]}'?")
        if entry in chosen:
            raise DataError(path, f"'{entry}' is listed twice; list every key only once")
        chosen.add(entry)
    return chosen

"""How to read a model's numbers on a benchmark, given what it was trained on and which pairs were evaluated.

"ID" means: trained on the domain, but on none of the evaluated frames. Whether that is so depends on the pairs.
`K:train` names the 120 pairs that the project's split leaves for training; evaluating one of them, by another
`--split`, in a small folder all of which is evaluated, or in the data set as a whole, measures the model on its
training data.

KITTI's raw data contain the frames of most pairs. A model trained on them without labels was trained on those frames
unless its authors left them out (`KR:train`); its numbers are "ID", and a note counts the pairs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from ..datasets.kitti_drives import drives, related
from ..datasets.split import KITTI_KEYS, KITTI_SPLITS, kitti_split
from ..datasets.still import pair_key
from ..models.provenance import RANDOM, Setting, Training
from .facts import is_still
from .registry import benchmark_facts

_KITTI = "kitti2015"
_RAW = "kitti-raw"
_RELEASED = "released"
PAIRS_NOTE = "pairs: "
"""The beginning of a note that follows from the evaluated pairs."""


def setting_of(
    training: Training,
    benchmark: str,
    keys: Collection[str] | None = None,
    protocol: Mapping[str, Any] | None = None,
) -> Setting:
    """The setting of a model on a benchmark, which says how to read its numbers.

    "OOD": trained on nothing of its domain. "ID": trained on its domain, but on none of the evaluated frames. "LEAKED":
    trained on evaluated frames. "knowledge": learns nothing. "untrained": random weights. "UNKNOWN": not declared,
    not known, or the frames are the user's own.

    Args:
        training: of the model.
        benchmark: its name.
        keys: the evaluated samples; the benchmark's usual ones by default.
        protocol: of the benchmark: whether the frames are the released ones.

    >>> setting_of(Training(("flyingchairs", "kitti2015"), "declared"), "kitti-fc")
    'LEAKED'
    >>> setting_of(Training(("kitti2015",), "declared"), "gopro-fc")
    'OOD'
    """
    return judge(training, benchmark, keys, protocol or {})[0]


def judge(
    training: Training, benchmark: str, keys: Collection[str] | None, protocol: Mapping[str, Any]
) -> tuple[Setting, list[str]]:
    """The setting, and notes about the evaluated pairs; arguments as for `setting_of`."""
    if not training.trained:
        return ("untrained" if training.basis == RANDOM else "knowledge"), []
    facts = benchmark_facts(benchmark)
    if is_still(benchmark) and keys is not None:
        keys = sorted(set(map(pair_key, keys)))
    if training.sets is None or not (facts.training_set or facts.same_domain):
        return "UNKNOWN", []
    if facts.training_set in training.sets:
        return "LEAKED", []
    perhaps = [name for name in (facts.training_set, *facts.same_domain) if f"{name}?" in training.sets]
    if perhaps:
        return "UNKNOWN", [f"it may have been trained on {', '.join(perhaps)}"]
    if keys is None and facts.training_set == _KITTI:
        keys = kitti_split(KITTI_KEYS).evaluation if facts.published else KITTI_KEYS
    parts = [name.partition(":")[2] for name in training.sets if name.startswith(f"{facts.training_set}:")]
    related_sets = {name for name in training.sets if name.partition(":")[0] in facts.same_domain}
    notes = [_raw_note(facts.training_set, keys)] if _RAW in related_sets and keys is not None else []
    settings: set[Setting] = {"ID"} if parts or related_sets else {"OOD"}
    if facts.training_set == _KITTI and keys is not None:
        for part in parts:
            setting, note = _kitti_part(part, keys, protocol)
            settings.add(setting)
            notes.append(note)
    worst = next(one for one in ("LEAKED", "UNKNOWN", "ID", "OOD") if one in settings)
    return worst, [f"{PAIRS_NOTE}{note}" for note in notes if note]


def _kitti_part(part: str, keys: Collection[str], protocol: Mapping[str, Any]) -> tuple[Setting, str]:
    """What `K:part` means for these pairs, and the note that must accompany it."""
    released = protocol.get("frames") == _RELEASED
    if released != (part == _RELEASED):
        own = "the released KITTI-FC has a different split, which K:released names"
        return "UNKNOWN", f"whether K:{part} holds evaluated pairs is unknown; {own}"
    if part == _RELEASED:
        return "ID", ""
    if not {*keys} <= {*KITTI_KEYS}:
        return "UNKNOWN", f"whether K:{part} holds evaluated pairs is unknown; they are not named as in KITTI"
    trained = KITTI_SPLITS[part](KITTI_KEYS).training
    seen = {*keys} & {*trained}
    if seen:
        return "LEAKED", f"{len(seen)} of the {len(keys)} evaluated are among the training pairs of K:{part}"
    known = [key for key in keys if key in drives(_KITTI)]
    near = related(known, trained)
    if not near:
        return "ID", ""
    return "ID", f"{len(near)} of the {len(known)} evaluated with a known drive share it with training pairs"


def _raw_note(training_set: str, keys: Collection[str]) -> str:
    count = sum(key in drives(training_set) for key in keys)
    return f"KITTI's raw data hold the frames of {count} of the {len(keys)} evaluated, seen unless they were left out"

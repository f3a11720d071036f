"""Classify a model's results on a benchmark by its training sets and the evaluated pairs.

"ID" means that the model was trained on the domain, but on none of the evaluated frames. This depends on the pairs:
`K:train` denotes the 120 training pairs of the project's split. If one of them is evaluated, because of a different
`--split`, a small folder, or an evaluation on the whole dataset, the model is evaluated on its training data. Datasets
without a standard split, such as Sintel, are evaluated whole, so the evaluated pairs in `S:train` are unknown. On the
user's videos, which `gopro-fc` also reads, the setting is unknown.

The setting follows from what the flow was trained on. A pre-trained backbone (SAM, Depth Anything, DINO) is a second
fact, `Provenance.backbone_note`.

KITTI's raw data contain the frames of most pairs. A model trained on the raw data without labels has seen these frames
unless its authors left them out (`KR:train`); its setting is "ID", and a note gives the number of pairs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from ...core.types import Frozen
from ...models.provenance import RANDOM, Setting, Training
from ..datasets import DATASETS
from ..datasets.kitti import drives, related
from ..datasets.split import KITTI_KEYS, KITTI_SPLITS, kitti_split
from ..datasets.still import pair_key
from .facts import is_still, moving_name
from .registry import benchmark_facts

_KITTI = "kitti2015"
_RAW = "kitti-raw"
_GOPRO = "gopro"
_SHAPES = "shapes"
_RELEASED = "released"


class Provenance(Frozen):
    """The training data of a model, and what they mean for its results on some samples of a benchmark."""

    setting: Setting
    trained_on: tuple[str, ...] | None
    basis: str
    note: str = ""
    backbone: str = ""

    @property
    def backbone_note(self) -> str:
        """What is known of the backbone, a second fact that decides no setting; empty without a backbone."""
        if not self.backbone:
            return ""
        unchecked = ", whose pre-training data were not checked" if self.backbone.endswith("?") else ""
        return f"backbone {self.backbone.removesuffix('?')}{unchecked}"


def provenance_of(
    training: Training,
    benchmark: str,
    keys: Collection[str] | None = None,
    protocol: Mapping[str, Any] | None = None,
) -> Provenance:
    """Return what the training sets of a model mean for its results on a benchmark, or on some of its samples."""
    setting, notes = _of_flow_training(training, benchmark, keys, protocol or {})
    note = "; ".join(filter(None, (training.note, *notes)))
    return Provenance(
        setting=setting, trained_on=training.sets, basis=training.basis, note=note, backbone=training.backbone
    )


def setting_of(
    training: Training,
    benchmark: str,
    keys: Collection[str] | None = None,
    protocol: Mapping[str, Any] | None = None,
) -> Setting:
    """Return the setting of a model on a benchmark, which is needed to interpret its results."""
    return provenance_of(training, benchmark, keys, protocol).setting


def _of_flow_training(
    training: Training, benchmark: str, keys: Collection[str] | None, protocol: Mapping[str, Any]
) -> tuple[Setting, list[str]]:
    if not training.trained:
        return ("untrained" if training.basis == RANDOM else "knowledge"), []
    facts = benchmark_facts(benchmark)
    if is_still(benchmark) and keys is not None:
        keys = sorted(set(map(pair_key, keys)))
    if training.sets is None or not (facts.training_set or facts.same_domain):
        return "UNKNOWN", []
    others = sum("GOPR" not in key for key in keys or ()) if facts.training_set == _GOPRO else 0
    if others:  # a video of the user, which gopro-fc also reads
        return "UNKNOWN", [f"pairs: {others} of the evaluated are not named as in GoPro"]
    if facts.training_set in training.sets:
        return "LEAKED", []
    perhaps = [name for name in (facts.training_set, *facts.same_domain) if f"{name}?" in training.sets]
    if perhaps:
        return "UNKNOWN", [f"pairs: the model may have been trained on these ({', '.join(perhaps)})"]
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
    elif parts and facts.training_set == _SHAPES:  # its splits share neither textures nor draws
        settings.add("LEAKED" if protocol.get("options", {}).get("split") == "train" else "ID")
    elif parts and moving_name(benchmark) in DATASETS:
        settings.add("UNKNOWN")
        notes.append(
            f"whether {facts.training_set}:train contains evaluated pairs is unknown, because it has no standard split"
        )
    worst = next(one for one in ("LEAKED", "UNKNOWN", "ID", "OOD") if one in settings)
    return worst, [f"pairs: {note}" for note in notes if note]


def _kitti_part(part: str, keys: Collection[str], protocol: Mapping[str, Any]) -> tuple[Setting, str]:
    unknown = f"whether K:{part} contains evaluated pairs is unknown, because"
    released = protocol.get("frames") == _RELEASED
    if released != (part == _RELEASED):
        return "UNKNOWN", f"{unknown} the released KITTI-FC has a different split, called K:released"
    if part == _RELEASED:
        return "ID", ""
    if not {*keys} <= {*KITTI_KEYS}:
        return "UNKNOWN", f"{unknown} they are not named as in KITTI"
    trained = KITTI_SPLITS[part](KITTI_KEYS).training
    leaked = {*keys} & {*trained}
    if leaked:
        return "LEAKED", f"{len(leaked)} of the {len(keys)} evaluated are among the training pairs of K:{part}"
    known = [key for key in keys if key in drives(_KITTI)]
    near = related(known, trained)
    if not near:
        return "ID", ""
    return "ID", f"{len(near)} of the {len(known)} evaluated with a known drive share that drive with training pairs"


def _raw_note(training_set: str, keys: Collection[str]) -> str:
    count = sum(key in drives(training_set) for key in keys)
    return (
        f"KITTI's raw data contain {count} of the {len(keys)} evaluated, which were seen in training unless they were "
        "left out"
    )

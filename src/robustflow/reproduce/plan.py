"""Determine which of the paper's variants can be run here, with which weights, and what the others require."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..analysis.labels import SETTING_LABELS
from ..benchmarks.setting import setting_of
from ..models import ModelSpec
from ..models.catalog import CheckpointEntry, checkpoints, is_installed, methods
from ..models.networks.table import NETWORKS
from ..models.provenance import training_of_entry
from ..models.torch.find_checkpoint import RANDOM
from ..report.table import Column, Line, Section, Table
from ..text import counted
from ..training.recipe import recipes_of, trained_methods
from .artefacts import Artefact
from .variants import Variant
from .weights import FoundWeights

_OF_PAPER = {"flyingchairs", "flyingthings3d", "sintel", "hd1k"}
"""Training sets of the paper's OOD models (see its appendix; no public checkpoint was trained on exactly these)."""

_GREY = "OpenCV's DIS on grey frames; the paper ran the RGB version, dis_rgb"


@dataclass(frozen=True)
class Runnable:
    """A variant that can be run."""

    variant: Variant
    spec: ModelSpec
    weights: str
    folder: str

    @property
    def random(self) -> bool:
        """Return whether the weights are random, in which case the results are not informative about the method."""
        return dict(self.spec.options).get("checkpoint") == RANDOM


@dataclass(frozen=True)
class Missing:
    """A variant that cannot be run, with the reason and the remedy, or whose run failed."""

    variant: Variant
    reason: str
    remedy: str
    failed: bool = False


def choose(
    variants: Sequence[Variant], benchmark: str, weights: Sequence[FoundWeights], *, random: bool = False
) -> list[Runnable | Missing]:
    """Choose weights for each variant."""
    return [_runnable_or_missing(variant, benchmark, weights, random) for variant in variants]


def _runnable_or_missing(
    variant: Variant, benchmark: str, weights: Sequence[FoundWeights], random: bool
) -> Runnable | Missing:
    entry = methods()[variant.model]
    if entry.type == "knowledge":
        return Runnable(variant, ModelSpec(variant.model), _GREY if variant.model == "dis" else "", variant.model)
    if not is_installed(entry):
        return Missing(variant, f"needs {entry.extra}", f"pip install 'robustflow[{entry.extra}]'")
    for file in weights:
        if file.claim == variant.slug:
            return _runnable(variant, file, f"own file {file.path.name}")
    of_catalogue = {file.entry.sha256: file for file in weights if file.entry is not None}
    nearest = _nearest(variant, benchmark, [file.entry for file in of_catalogue.values() if file.entry is not None])
    if nearest is not None:
        sets = ", ".join(nearest.trained_on.split("+"))
        stand_in = f"stand-in {nearest.model} {nearest.checkpoint}, trained on {sets}"
        return _runnable(variant, of_catalogue[nearest.sha256], stand_in)
    if random:
        spec = ModelSpec(variant.model, (("checkpoint", RANDOM),))
        return Runnable(variant, spec, "RANDOM WEIGHTS: not informative about the method", f"{variant.model}-random")
    return Missing(variant, _reason(variant, benchmark, weights), _remedy(variant, benchmark))


def _runnable(variant: Variant, file: FoundWeights, weights: str) -> Runnable:
    spec = ModelSpec(variant.model, (("checkpoint", str(file.path)),))
    return Runnable(variant, spec, weights, f"{variant.slug}-{file.sha256}")


def _nearest(variant: Variant, benchmark: str, entries: Sequence[CheckpointEntry]) -> CheckpointEntry | None:
    fitting = [
        entry
        for entry in entries
        if entry.model == variant.model and setting_of(training_of_entry(entry), benchmark) == variant.setting
    ]

    def distance(entry: CheckpointEntry) -> tuple[int, bool]:
        # Of two checkpoints with the same training sets, one fine-tuned on KITTI is further from the paper's.
        return len({*entry.trained_on.split("+")} ^ _OF_PAPER), entry.checkpoint == "kitti"

    return min(fitting, key=distance, default=None)


def _reason(variant: Variant, benchmark: str, weights: Sequence[FoundWeights]) -> str:
    altered = [file for file in weights if file.altered is not None and file.altered.model == variant.model]
    if altered:
        return f"{altered[0].path} has the wrong hash for a file with this name; download it again"
    others = {
        setting_of(training_of_entry(file.entry), benchmark): file.path.name
        for file in weights
        if file.entry is not None and file.entry.model == variant.model
    }
    others_are = [f"{name} is {setting} on {benchmark}, not {variant.setting}" for setting, name in others.items()]
    return others_are[0] if others_are else "no checkpoint found"


def _remedy(variant: Variant, benchmark: str) -> str:
    ways = []
    public = _nearest(variant, benchmark, checkpoints())
    if public is not None:
        ways.append(f"download a stand-in: {public.address}")
    elif variant.model in NETWORKS:
        ways.append(f"{NETWORKS[variant.model].source}, saved as {variant.slug}.pth")
    stages = recipes_of(variant.model) if variant.model in trained_methods() else {}
    stage = next((stage for stage in (variant.setting.lower(), "unsupervised") if stage in stages), None)
    if stage is not None:
        ways.append(f"train it: robustflow train {variant.model} --recipe {stage} --output trainings/{variant.slug}")
    return "; or ".join(ways)


def plan_table(artefact: Artefact, choices: Sequence[Runnable | Missing]) -> Table:
    """Return the weights each variant would run with, or what the variant requires."""
    lines: dict[str, list[Line]] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            texts = ("no", choice.reason, choice.remedy)
        else:
            texts = ("yes", choice.weights or "needs no weights", "")
        lines.setdefault(choice.variant.setting, []).append(Line.of(choice.variant.method, texts))
    columns = (Column("Runs"), Column("Weights", prose=True), Column("How to get it", prose=True))
    sections = tuple(Section(SETTING_LABELS.get(setting, setting), tuple(some)) for setting, some in lines.items())
    return Table(f"{artefact.name}-plan", f"{artefact.name}: what can be run here", columns, sections)


def summary_sentence(choices: Sequence[Runnable | Missing]) -> str:
    """Return a sentence with the number of variants that can be run."""
    runnable = [choice for choice in choices if isinstance(choice, Runnable)]
    random = sum(choice.random for choice in runnable)
    text = f"{len(runnable)} of {counted(len(choices), 'variant')} can be run here"
    return f"{text}, {random} of them with RANDOM WEIGHTS." if random else f"{text}."

"""What of the paper can be reproduced here: its tables and figures, its variants (a method in a setting, with the model
of this package), and their checkpoints, found in a folder by the catalogue's hashes or by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..core.errors import DataError, UsageError, unknown_name
from ..core.files import sha256_of_file
from ..core.paths import user_path
from ..core.text import counted
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.setting import setting_of
from ..models import ModelRef
from ..models.catalog import CheckpointEntry, checkpoints, is_installed, methods
from ..models.networks.loaders import NETWORKS
from ..models.provenance import training_of_entry
from ..models.torch.build import RANDOM
from ..report.table import Column, Row, Table
from ..stats.published.tables import published_lines
from ..stats.results import SETTING_LABELS
from ..training.recipe import recipes_of, trained_methods

ColumnChoice = Literal["epe", "cre", "rcre", "crer", "means", "families"]
"""Kind of comparison: a metric under each corruption, overall means, or CREr by corruption family."""


@dataclass(frozen=True)
class Artefact:
    """A table or a figure in the paper."""

    name: str
    title: str
    benchmark: str = ""
    columns: ColumnChoice = "epe"
    table: str = ""
    figure: str = ""
    instead: str = ""


_ALL = (
    Artefact(
        "tab1",
        "The 15 evaluated methods",
        instead="robustflow list models (model, type and year; not the encoders and decoders)",
    ),
    Artefact("tab2", "EPE on KITTI-FC", "kitti-fc", "epe", table="epe"),
    Artefact(
        "tab3",
        "CREr and computing cost",
        "kitti-fc",
        "crer",
        table="cost",
        instead="its parameters and FLOPs next to ours: robustflow profile --paper",
    ),
    Artefact("tab4", "RCRE on GoPro-FC", "gopro-fc", "rcre", table="gopro-rcre"),
    Artefact("tab5", "Training of the supervised OOD models", instead="robustflow train MODEL --recipe ood --plan"),
    Artefact("tab6", "Training of the supervised ID models", instead="robustflow train MODEL --recipe id --plan"),
    Artefact("tab7", "CRE on KITTI-FC", "kitti-fc", "cre", table="cre"),
    Artefact("tab8", "RCRE on KITTI-FC", "kitti-fc", "rcre", table="rcre"),
    Artefact("fig1", "The benchmarks, as a drawing", instead="no command, as it is a drawing"),
    Artefact(
        "fig2",
        "The 24 corruptions at severity 5",
        instead="robustflow gallery --severity 5 --clip CLIP; without --clip, the video corruptions are missing, and "
        "object_motion_blur needs the frames in between",
    ),
    Artefact(
        "fig3",
        "How CRE and RCRE are computed, as a drawing",
        instead="robustflow report RUN --examples draws frames, flows and errors for pairs of a run",
    ),
    Artefact("fig4", "Clean EPE, CRE and CREr on KITTI-FC", "kitti-fc", "means", figure="clean_against_cre"),
    Artefact("fig5", "CREr by corruption class", "kitti-fc", "families", figure="crer_by_family"),
    Artefact("fig6", "SAM's segmentation of the frames", instead="no command, as it contains no flow measurements"),
    Artefact("fig7", "The PSFs of psf_blur", instead="robustflow optics show"),
    Artefact(
        "fig8", "Distribution of flow magnitudes", instead="robustflow reproduce displacement BENCHMARK --data DATA"
    ),
    Artefact("fig9", "Scatter plots of clean EPE, EPE, CRE and RCRE", "kitti-fc", "means", figure="relations"),
)

ARTEFACTS = {artefact.name: artefact for artefact in _ALL}
"""Every table and figure of the paper, by name."""


def artefact_of(name: str) -> Artefact:
    """Return a table or figure by name.

    >>> artefact_of("tab2").title
    'EPE on KITTI-FC'
    """
    if name.lower() not in ARTEFACTS:
        raise unknown_name("table or figure", name, ARTEFACTS)
    return ARTEFACTS[name.lower()]


def data_hint(artefact: Artefact) -> str:
    """Return a sentence that explains how to reproduce a table or figure."""
    return (
        f"To reproduce it, run: robustflow reproduce {artefact.name} --data FOLDER "
        f"({benchmark_facts(artefact.benchmark).data}) --checkpoints FOLDER; --dry-run lists the models that can be "
        "run, and where to get weights for the others."
    )


def contents() -> list[str]:
    """Return one line per table and figure: its title, and its benchmark or the command that shows the same content."""
    lines = [
        f"{artefact.name:5s} {artefact.title}"
        + (f" (--data: {artefact.benchmark})" if artefact.benchmark else f": {artefact.instead}")
        for artefact in ARTEFACTS.values()
    ]
    return [*lines, "Further commands: robustflow reproduce audit, observations or displacement."]


_OPTIONS: dict[str, tuple[tuple[str, str], ...]] = {"farneback": (("preset", "opencv"),)}
"""Options with which a model is run: the paper states OpenCV's default parameters."""

_RUN_AS = {"DIS": "dis_rgb"}
"""Methods whose name in the paper refers to a different model in this package: the paper ran the authors' DIS on colour
images (docs/dis-rgb.md)."""


@dataclass(frozen=True)
class Variant:
    """A method from the paper in one setting."""

    method: str
    setting: str
    model: str

    @property
    def slug(self) -> str:
        """Return the file name of the variant's weights in a checkpoint folder, without the extension."""
        return self.model if self.setting == "knowledge" else f"{self.model}-{self.setting.lower()}"


def paper_variants(benchmark: str, wanted: Sequence[str] | None = None) -> list[Variant]:
    """Return the variants with published values on a benchmark, in the paper's order."""
    lines = [line for line in published_lines() if line.benchmark == benchmark]
    names = {entry.method: name for name, entry in methods().items()} | _RUN_AS
    every = [Variant(line.model, line.setting, names[line.model]) for line in lines]
    if wanted is None:
        return every
    chosen: dict[str, str] = {}
    for name in wanted:
        method, model = _named(name, every)
        if chosen.get(method, model) != model:
            raise UsageError(
                method, f"can be run as only one model at a time; choose either {chosen[method]} or {model}"
            )
        chosen[method] = model
    return [Variant(v.method, v.setting, chosen[v.method]) for v in every if v.method in chosen]


def _named(name: str, every: Sequence[Variant]) -> tuple[str, str]:
    """Return the paper's name and the model to run."""
    entry = methods().get(name)
    for variant in every:
        if name in (variant.method, variant.model) or (entry is not None and entry.method == variant.method):
            return variant.method, name if entry is not None else variant.model
    raise unknown_name("published model", name, dict.fromkeys(variant.model for variant in every))


SUFFIXES = (".ckpt", ".pth", ".pt", ".tar")
"""File extensions of checkpoints."""
_TRAINED = "last"
"""File name of the final weights of `robustflow train`; the name of their folder identifies the variant."""


@dataclass(frozen=True)
class FoundWeights:
    """A file in a checkpoint folder."""

    path: Path
    sha256: str
    entry: CheckpointEntry | None
    claim: str
    altered: CheckpointEntry | None = None


def weights_in(folders: Sequence[Path]) -> list[FoundWeights]:
    """Return the possible checkpoint files in folders and their subfolders, sorted by path."""
    by_hash = {entry.sha256: entry for entry in checkpoints()}
    by_name = {entry.file: entry for entry in checkpoints()}
    weights = []
    for path in _files(folders):
        digits = _sha256(path)[:8]
        entry = by_hash.get(digits)
        named = by_name.get(path.name)
        claim = path.parent.name if path.stem == _TRAINED else path.stem
        weights.append(FoundWeights(path, digits, entry, claim.lower(), named if entry is None else None))
    return weights


def _files(folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        folder = user_path(folder)
        if not folder.is_dir():
            raise DataError(folder, "no such folder; give the folder that contains the checkpoints")
        yield from sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())


def _sha256(path: Path) -> str:
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); move it out of the checkpoint folder") from error


_OF_PAPER = {"flyingchairs", "flyingthings3d", "sintel", "hd1k"}
"""Training sets of the paper's OOD models (see its appendix; no public checkpoint was trained on exactly these)."""

_GREY = "OpenCV's DIS on grey frames; the paper ran the RGB version, dis_rgb"


@dataclass(frozen=True)
class Runnable:
    """A variant that can be run."""

    variant: Variant
    ref: ModelRef
    weights: str
    folder: str

    @property
    def random(self) -> bool:
        """Return whether the weights are random, in which case the results are not informative about the method."""
        return self.ref.checkpoint == RANDOM


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
        ref = ModelRef.parse(variant.model, _OPTIONS.get(variant.model, ()))
        return Runnable(variant, ref, _GREY if variant.model == "dis" else "", variant.model)
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
        ref = ModelRef.parse(variant.model, {"checkpoint": RANDOM})
        return Runnable(variant, ref, "RANDOM WEIGHTS: not informative about the method", f"{variant.model}-random")
    return Missing(variant, _reason(variant, benchmark, weights), _remedy(variant, benchmark))


def _runnable(variant: Variant, file: FoundWeights, weights: str) -> Runnable:
    ref = ModelRef.parse(variant.model, {"checkpoint": str(file.path)})
    return Runnable(variant, ref, weights, f"{variant.slug}-{file.sha256}")


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
    stages = recipes_of(variant.model) if variant.model in trained_methods() else {}
    if public is not None:
        ways.append(f"download a stand-in: {public.address}")
    elif variant.model in NETWORKS and not (variant.setting == "ID" and "id" in stages):
        without = " if it was not trained on KITTI" if variant.setting == "OOD" else ""
        ways.append(f"{NETWORKS[variant.model].source}, saved as {variant.slug}.pth{without}")
    stage = next((stage for stage in (variant.setting.lower(), "unsupervised") if stage in stages), None)
    if stage is not None:
        ways.append(f"train it: robustflow train {variant.model} --recipe {stage} --output trainings/{variant.slug}")
    return "; or ".join(ways)


def plan_table(artefact: Artefact, choices: Sequence[Runnable | Missing]) -> Table:
    """Return the weights each variant would run with, or what the variant requires."""
    rows: dict[str, list[Row]] = {}
    for choice in choices:
        if isinstance(choice, Missing):
            texts = ("no", choice.reason, choice.remedy)
        else:
            texts = ("yes", choice.weights or "needs no weights", "")
        setting = choice.variant.setting
        rows.setdefault(SETTING_LABELS.get(setting, setting), []).append(Row(choice.variant.method, texts))
    columns = ("Runs", Column("Weights", prose=True), Column("How to get it", prose=True))
    return Table.of(f"{artefact.name}-plan", f"{artefact.name}: what can be run here", columns, rows, keep_empty=True)


def summary_sentence(choices: Sequence[Runnable | Missing]) -> str:
    """Return a sentence with the number of variants that can be run."""
    runnable = [choice for choice in choices if isinstance(choice, Runnable)]
    random = sum(choice.random for choice in runnable)
    text = f"{len(runnable)} of {counted(len(choices), 'variant')} can be run here"
    return f"{text}, {random} of them with RANDOM WEIGHTS." if random else f"{text}."

"""`robustflow list`: list available models, corruptions, attacks, benchmarks, datasets and recipes."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Annotated

import typer
from typer import Argument

from ..core.arguments import SEVERITIES
from ..core.errors import UsageError, unknown_name
from ..core.output import echo, stream
from . import complete
from .complete import KINDS

_OF_FILES = {"precomputed": ("a folder of flow files", ""), "onnx": ("an .onnx file", "onnx")}
"""For each generic model, what it loads a method from and the extra it needs, named after the module it installs."""


def listing(
    kind: Annotated[
        str,
        Argument(
            metavar="KIND",
            autocompletion=complete.kinds,
            help="models, corruptions, attacks, benchmarks, datasets or recipes; all by default.",
        ),
    ] = "all",
    search: Annotated[str, Argument(metavar="SEARCH", help="With models: part of a name, to list checkpoints.")] = "",
) -> None:
    """List models, corruptions, attacks, benchmarks, datasets or training recipes.

    \b
    Examples:
      robustflow list corruptions
      robustflow list models sea_raft
    """
    if search and kind != "models":
        raise UsageError(search, "only models can be searched")
    if kind != "all" and kind not in KINDS:
        raise unknown_name("kind", kind, (*KINDS, "all"))
    for name in KINDS if kind == "all" else (kind,):
        if kind == "all":
            typer.secho(f"\n{name}", bold=True, file=stream())
        echo("\n".join(_published(search) if search else _LISTERS[name]()))


def _models() -> list[str]:
    from ..models import MODELS
    from ..models.catalog import is_in_ptlflow, methods
    from ..models.ptlflow.loaders import BESIDES

    seen = _checkpoints()
    head = ("model", "method", "year", "type", "source", "code licence", "here", "checkpoints, on kitti-fc")
    lines = [head, *(_model_line(name, seen) for name in MODELS.names())]
    others = [name for name in seen if is_in_ptlflow(name)]
    return [
        *_aligned(lines),
        f"{len(others)} more from ptlflow: {', '.join(others)}.",
        "'robustflow list models NAME' shows the training data of a model's checkpoints, and the evidence for it.",
        f"Needed besides ptlflow: {'; '.join(f'{name} ({needs})' for name, needs in BESIDES.items())}.",
        "OOD: not trained on KITTI; ID: trained on KITTI, but not on evaluated pairs; LEAKED: trained on evaluated "
        "pairs; UNKNOWN: not documented (declare with --trained-on C+T). + NAME: a pre-trained backbone; ?: its data "
        "were not checked.",
        f"multi-frame: up to {max(method.frames for method in methods().values())} frames; needs data with clips.",
        "Few of the published weights come with a licence.",
        "Your own: module.path:Attribute, an exported network (.onnx) or a folder of flow files.",
    ]


def _checkpoints() -> dict[str, list[str]]:
    """Return the published checkpoints of each model, with their setting on kitti-fc."""
    from ..data.benchmarks.setting import setting_of
    from ..models.catalog import checkpoints
    from ..models.provenance import training_of_entry

    seen: dict[str, list[str]] = {}
    for entry in checkpoints():
        setting = setting_of(training_of_entry(entry), "kitti-fc")
        backbone = f" + {entry.backbone}" if entry.backbone else ""
        seen.setdefault(entry.model, []).append(f"{entry.checkpoint} {setting}{backbone}")
    return seen


def _model_line(name: str, seen: dict[str, list[str]]) -> tuple[str, ...]:
    from ..data.benchmarks.setting import setting_of
    from ..models.catalog import is_installed, methods
    from ..models.provenance import DECLARED, Training, parse_training_sets
    from ..models.tiny.tiny import SHIPPED, shipped_weights

    if name in _OF_FILES:
        what, extra = _OF_FILES[name]
        here = "yes" if not extra or find_spec(extra) else f"needs [{extra}]"
        return name, "any", "", "", "your files", "", here, f"{what}, UNKNOWN"
    if name not in methods():
        return name, *[""] * 7
    method = methods()[name]
    here = "yes" if is_installed(method) else f"needs [{method.extra}]"
    if name in SHIPPED:
        sets = parse_training_sets(shipped_weights(name).trained_on)
        public = f"shipped {setting_of(Training(sets=sets, basis=DECLARED), 'kitti-fc')}"
    elif method.type == "knowledge":
        public = "not trained"
    else:
        public = ", ".join(seen.get(name, [])) or "the authors' file, UNKNOWN"
    kind = method.type if method.frames == 2 else "multi-frame"
    return name, method.method, str(method.year), kind, method.source, method.code_licence, here, public


def _published(search: str) -> list[str]:
    """Return the published checkpoints of models with `search` in their name, with their training data."""
    from ..data.benchmarks.setting import setting_of
    from ..models import MODELS
    from ..models.catalog import checkpoints, entries_of, methods
    from ..models.provenance import training_of_entry

    names = sorted({*MODELS.names(), *(entry.model for entry in checkpoints())})
    labels = {name: method.method.lower() for name, method in methods().items()}
    term = search.lower()
    matching = [name for name in names if term.replace("-", "_") in name or term in labels.get(name, "")]
    if not matching:
        raise unknown_name("model", search, names)
    lines = []
    for name in matching:
        entries = entries_of(name)
        lines += [] if entries else [f"{name}: no published checkpoints"]
        for entry in entries:
            training = training_of_entry(entry)
            settings = ", ".join(
                f"{setting_of(training, data)} on {data}" for data in ("kitti-fc", "sintel", "gopro-fc")
            )
            sets, backbone = entry.trained_on.replace("+", ", "), entry.backbone or "none known"
            lines.append(f"{name} {entry.checkpoint}: {settings}; trained on {sets}; backbone {backbone}")
            lines.append(f"    confidence {entry.confidence}: {entry.note or 'as stated by the authors'}")
    return lines


def _aligned(lines: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]


def _corruptions() -> list[str]:
    from ..corruptions import CORRUPTIONS, load_corruption
    from ..corruptions.optics.psf_field import RMS_RADII
    from ..corruptions.registry import heading_of

    lines: list[tuple[str, ...]] = []
    for name in CORRUPTIONS.names():
        corruption = load_corruption(name)
        levels = (tuple(level) if isinstance(level, tuple) else level for level in corruption.severities)
        parameters = ", ".join(map(str, levels))
        lines.append((name, heading_of(name), "temporal" if corruption.temporal else "", parameters))
    radii = ", ".join(map(str, RMS_RADII))
    return [*_aligned(lines), f"psf_blur: RMS radii in mm of the paper's lenses; ours have {radii}."]


def _attacks() -> list[str]:
    from ..attacks import load_attack
    from ..attacks.registry import ATTACKS

    attacks = {name: load_attack(name) for name in ATTACKS.names()}
    lines: list[tuple[str, ...]] = [
        (name, attack.norm, attack.needs, ", ".join(f"{attack.budget(severity):g}" for severity in SEVERITIES))
        for name, attack in attacks.items()
    ]
    return [
        *_aligned(lines),
        "Budgets of severities 1 to 5 in grey levels (0 to 255), or in % of the pixels for areas.",
    ]


def _benchmarks() -> list[str]:
    from ..data.benchmarks import BENCHMARKS, benchmark_facts
    from ..data.datasets import DATASETS, dataset_facts

    lines = []
    for name in (*BENCHMARKS.names(), *(name for name in DATASETS.names() if dataset_facts(name).corruptions)):
        facts = benchmark_facts(name)
        truth = "EPE, CRE, CREr, RCRE" if facts.has_flow else "RCRE (no ground truth)"
        lines += [f"{name}: {facts.description}", f"    metrics: {truth}"]
        lines += [f"    --data: {facts.data}"] if facts.data else []
    return [*lines, "DATASET: any other dataset, by name, under every image-pair corruption."]


def _datasets() -> list[str]:
    from ..data.datasets import DATASETS, dataset_facts

    lines = []
    for name in DATASETS.names():
        facts = dataset_facts(name)
        count = f"{facts.pairs:,} pair{'s' if facts.pairs != 1 else ''}, " if facts.pairs else ""
        lines.append(f"{name}: {facts.title}. {facts.description}".rstrip())
        lines.append(
            f"    {count}ground truth: {facts.ground_truth}, further frames: {facts.clips}, depth: {facts.depth}"
        )
        stated = {"layout": facts.layout, "licence": facts.licence, "citation": facts.citation}
        lines += [f"    {what}: {text}" for what, text in stated.items() if text]
    return [*lines, "Sizes of frames are HEIGHTxWIDTH."]


def _recipes() -> list[str]:
    from ..training.recipe import recipes_of, trained_methods

    lines = []
    for method in trained_methods():
        lines.append(f"{method}:")
        for stage, recipe in recipes_of(method).items():
            crop = f"{recipe.crop[0]}x{recipe.crop[1]}"
            lines.append(
                f"    {stage:12s} {recipe.updates:7d} updates of {recipe.pairs} pairs at {crop:8s} learning rate "
                f"{recipe.learning_rate:g}, starts from {recipe.start}, trained on {recipe.mix}"
            )
    return [*lines, "'robustflow train METHOD --recipe STAGE --plan' shows a full recipe and the data that it needs."]


_LISTERS = {
    "models": _models,
    "corruptions": _corruptions,
    "attacks": _attacks,
    "benchmarks": _benchmarks,
    "datasets": _datasets,
    "recipes": _recipes,
}

"""Pages of available names from the registries: models with their checkpoints, benchmarks, datasets, recipes."""

from __future__ import annotations

from robustflow.data.benchmarks import BENCHMARKS, benchmark_facts
from robustflow.data.benchmarks.setting import setting_of
from robustflow.data.datasets import DATASETS, dataset_facts
from robustflow.models.catalog import CheckpointEntry, checkpoints, methods
from robustflow.models.provenance import training_of_entry
from robustflow.training.recipe import recipes_of, trained_methods

from .tables import table


def files() -> dict[str, str]:
    """Make one page."""
    parts = [
        "---\nhide:\n  - toc\n---",
        "# Catalogue",
        "Every name that the command line accepts. `robustflow list` prints the same names and shows what is "
        "installed on your machine. The corruptions have [separate pages](../corruptions/index.md).",
        "## Models",
        "You can also use your own `module.path:Attribute`, an exported network (`.onnx`), a folder of flow files, and "
        "every model of ptlflow under its ptlflow name.",
        _methods(),
        "### Checkpoints",
        "The training data of each published checkpoint, and the resulting setting on a benchmark. OOD: trained on "
        "nothing from the benchmark's domain; ID: trained on that domain, but on none of the evaluated pairs; LEAKED: "
        "trained on evaluated pairs; UNKNOWN: not documented by the authors, or with a backbone whose pre-training was "
        "not checked (`?`), and never ranked with OOD. `?` also marks possible training data.",
        _checkpoints(),
        "## Benchmarks",
        _benchmarks(),
        "## Datasets",
        "Each dataset is also a benchmark of the same name, with every corruption of image pairs.",
        _datasets(),
        "## Training recipes",
        _recipes(),
    ]
    return {"reference/catalogue.md": "\n\n".join(parts) + "\n"}


def _compact(heading: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table with columns as narrow as their words, so that it fits the page."""
    return f'<div class="compact" markdown>\n\n{table(heading, rows)}\n\n</div>'


def _methods() -> str:
    rows = [
        (f"`{m.model}`", m.method, m.year, m.type, m.frames, m.source, m.extra and f"`{m.extra}`", m.code_licence)
        for m in methods().values()
    ]
    return _compact(
        ("name", "method", "year", "type", "frames", "implementation", "extra", "licence of the code"), rows
    )


def _checkpoints() -> str:
    rows = [
        (
            f"`{c.model}`",
            f"`{c.checkpoint}`",
            c.trained_on.replace("+", ", "),
            c.backbone,
            *_settings(c),
            c.confidence,
            c.note,
        )
        for c in checkpoints()
    ]
    columns = ("model", "checkpoint", "flow training", "backbone", *_BENCHMARKS.values(), "confidence", "evidence")
    return _compact(columns, rows)


_BENCHMARKS = {"kitti-fc": "on KITTI-FC", "sintel": "on Sintel", "gopro-fc": "on GoPro-FC"}


def _settings(entry: CheckpointEntry) -> list[str]:
    return [setting_of(training_of_entry(entry), name) for name in _BENCHMARKS]


def _benchmarks() -> str:
    rows = []
    for name in (*BENCHMARKS.names(), *(name for name in DATASETS.names() if dataset_facts(name).corruptions)):
        facts = benchmark_facts(name)
        measured = "EPE, CRE, CREr, RCRE" if facts.has_flow else "RCRE"
        rows.append((f"`{name}`", facts.description, measured, facts.data, len(facts.paper_corruptions)))
    return _compact(("name", "what", "metrics", "`--data`", "corruptions in the paper's mean"), rows)


def _datasets() -> str:
    rows = []
    for name in DATASETS.names():
        f = dataset_facts(name)
        further = f.clips and f"Further frames: {f.clips}."
        what = " ".join(filter(None, (f"{f.title}.", f.description, further, f.citation and f"*{f.citation}*")))
        rows.append((f"`{name}`", what, f.pairs, f.ground_truth, f.layout, f.licence))
    return _compact(("name", "what", "pairs", "ground truth", "layout", "licence"), rows)


def _recipes() -> str:
    rows = []
    for name in trained_methods():
        for stage, r in recipes_of(name).items():
            crop, rate = f"{r.crop[0]}x{r.crop[1]}", f"{r.learning_rate:g}"
            rows.append((f"`{name}`", f"`{stage}`", r.updates, r.batch, crop, rate, r.start, r.mix))
    return _compact(("model", "recipe", "updates", "pairs each", "crop", "learning rate", "begins with", "data"), rows)

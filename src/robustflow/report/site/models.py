"""The page of a model: its means, its numbers under every corruption, and facts about the run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from ...core.text import counted, plain
from ...data.benchmarks import benchmark_facts
from ...metrics.measures import LEADING
from ...run.costs import RunCost
from ...run.identity import Environment
from ...run.manifest import Cells as RunCells
from ...run.manifest import left_out_sentence
from ...stats.frame import DERIVED
from ...stats.lines import LineKey, Lines, Numbers
from ...stats.notes import comparison_note
from ...stats.published.tables import method_of
from ...stats.results import (
    AVERAGE,
    CLEAN,
    LABELS,
    OVERALL,
    benchmark_label,
    long_label,
    mean_label,
    metric_label,
)
from ..leaderboard import Cells, marked_cells
from ..table import Column, Table, cell_of, condition_rows, with_exclusion
from .content import Content

if TYPE_CHECKING:
    from ...run.run import Run

_LONGEST = 600
_WITHOUT_TRAINING = {"knowledge": "none: not a learned method", "untrained": "none: its weights are random"}
_METRICS = ("cre", "rcre", "epe")
SCORES, SHADED, FACTS = "scores", "shaded", "facts"
"""Names of the tables of a model's page, which decide how its script shows them."""


def model_pages(content: Content) -> dict[str, tuple[str, list[Table]]]:
    """Return the name and the tables of each model of each sample set, by the id of its page."""
    by_page: dict[str, dict[LineKey, Numbers]] = {}
    for key, page in content.pages.items():
        by_page.setdefault(page, {})[key] = content.lines[key]
    marked = marked_cells(content.lines)
    pages = {}
    for page, lines in by_page.items():
        first = next(iter(lines))
        run = content.runs.get(first)
        tables = [_scores(key, numbers, marked[key], content.asked) for key, numbers in lines.items()]
        tables += _by_severity(lines[first]) if run else _by_setting(lines)
        facts = _run_facts(run) if run else _given_facts(lines)
        rows = [(label, [plain(text, _LONGEST)]) for label, text in facts if text]
        tables.append(Table.of(FACTS, "About this result", [""], {"": rows}, keep_empty=True))
        pages[page] = plain(first.model), [table for table in tables if table.columns]
    return pages


def _scores(key: LineKey, numbers: Numbers, cells: Cells, asked: str) -> Table:
    over = (*OVERALL, *[(asked, AVERAGE)] * bool(asked))
    columns = [Column(mean_label(*of), key=(*of, None)) for of in dict.fromkeys(over) if (*of, None) in cells]
    row = (
        plain(key.setting, 40),
        [cells[column.key] for column in columns],
        plain(with_exclusion(numbers.fact("note"), numbers.fact("excluded")), 600),
    )
    return Table.of(SCORES, benchmark_label(key.benchmark), columns, {"": [row]})


def _by_severity(numbers: Numbers) -> Iterator[Table]:
    """Yield tables of a run by corruption and severity; that of the photometric error only without ground truth."""
    blind = (LEADING, CLEAN, None) not in numbers
    names, levels = numbers.corruptions(), numbers.severities()
    for metric in ("epe", "cre", "rcre", *["photometric"] * blind, "spread"):
        if not numbers.by_corruption(metric):
            continue
        top = scale_top(numbers.number(metric, name, level) for level in levels for name in names)
        columns = [Column(str(at or "mean"), key=(metric, at), strongest=top) for at in (*levels, None)]
        rows = condition_rows(numbers, columns, {plain(long_label(name)): (name, None) for name in names})
        label = "Standard deviation over draws (px)" if metric == "spread" else metric_label(metric)
        title = f"{label} by severity"
        yield Table.of(SHADED, title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


def _by_setting(lines: Lines) -> Iterator[Table]:
    """Yield a table of each benchmark: the values of each metric in each setting."""
    for benchmark in dict.fromkeys(key.benchmark for key in lines):
        here = {key: numbers for key, numbers in lines.items() if key.benchmark == benchmark}
        known = Numbers(item for numbers in here.values() for item in numbers.items()).corruptions(_METRICS)
        shown = [(m, key) for m in _METRICS for key, numbers in here.items() if numbers.by_corruption(m)]
        tops = {m: scale_top(here[key].number(m, name) for _, key in shown for name in known) for m in _METRICS}
        rows = [
            (
                "Average" if name == AVERAGE else long_label(name),
                [cell_of(here[key][m, name, None]) if (m, name, None) in here[key] else None for m, key in shown],
            )
            for name in [*known, AVERAGE]
        ]
        columns = [Column(f"{LABELS[m]} {plain(key.setting, 40)}", strongest=tops[m]) for m, key in shown]
        title = f"{benchmark_label(benchmark)} (px)"
        yield Table.of(SHADED, title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


def _run_facts(run: Run) -> list[tuple[str, str]]:
    """Return facts about a run from its manifest: model, data, seed, versions, omitted data, and differences from the
    paper."""
    manifest, provenance = run.manifest, run.provenance
    frames, published = manifest.identity.frames, benchmark_facts(run.benchmark).published
    model = manifest.identity.model.settings.items()
    return [
        ("Source", f"verified record {run.record}" if run.record else "measured"),
        ("Model", ", ".join(f"{key}: {value}" for key, value in model if value not in ({}, None, ""))),
        ("Setting", run.setting),
        ("Trained on", _trained_on(run.setting, provenance.trained_on)),
        ("Pre-trained backbone", provenance.backbone_note.removeprefix("backbone ")),
        ("Evidence for the training data", provenance.basis),
        ("Note on training", provenance.note),
        ("Benchmark", f"{frames.benchmark} ({frames.dataset})"),
        ("Samples", str(len(manifest.samples))),
        ("Difference from the paper" if published else "Measured on", comparison_note(run)),
        ("Severities", ", ".join(map(str, manifest.severities))),
        ("Severity scale", str(frames.made_with["severity_scale"])),
        ("Left out", left_out_sentence(run.left_out) if run.left_out else ""),
        ("Seed", str(frames.made_with["seed"])),
        ("Corruption variant", str(frames.made_with["variant"])),
        ("Cost", _cost(run)),
        ("Run", manifest.identity_digest),
        ("Packages", _packages(manifest.environment)),
        *[
            (f"Packages of {counted(sum(map(RunCells.count, part.made)), 'earlier row')}", _packages(part))
            for part in manifest.earlier
        ],
    ]


def _packages(environment: Environment) -> str:
    return ", ".join(f"{name} {version}" for name, version in environment.packages.items())


def _given_facts(lines: Lines) -> list[tuple[str, str]]:
    """Return the sources of a model's values, and its method if the paper describes it."""
    method = method_of(next(iter(lines)).model)
    first = next(iter(lines.values()))
    origins = [row["origin"] for numbers in lines.values() for row in numbers.values() if row["origin"] != DERIVED]
    facts = [("Source", ", ".join(filter(None, dict.fromkeys([first.fact("source"), *origins]))))]
    if method is not None:
        described = f"{method.method} ({method.type}, {method.year})"
        facts += [("Method", described), ("Encoder", method.encoder), ("Decoder", method.decoder)]
    return facts


def _trained_on(setting: str, names: Sequence[str] | None) -> str:
    if setting in _WITHOUT_TRAINING:
        return _WITHOUT_TRAINING[setting]
    return "not declared" if names is None else ", ".join(names) or "nothing"


def _cost(run: Run) -> str:
    cost = RunCost.read(run)
    if cost is None:
        return ""
    size = f"{cost.parameters_m:.2f} M parameters, {cost.flops_g:.1f} G MACs (as thop)"
    size += f" for {cost.width} x {cost.height} frames"
    return size + (f", {cost.seconds:.3f} s on {cost.device}" if cost.seconds is not None else "")


def scale_top(values: Iterable[float | None]) -> float:
    """Return the value of the strongest colour: the 95th percentile, so that one outlier does not make all other cells
    pale.

    >>> scale_top([1.0, None, 2.0, -3.0])
    3.0
    """
    known = sorted(abs(value) for value in values if value is not None)
    return known[min(len(known) - 1, int(0.95 * len(known)))] if known else 0.0

"""The page of a model: its means, its numbers under every corruption, and facts about the run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from ...core.text import counted, plain
from ...corruptions.registry import ordered
from ...data.benchmarks import benchmark_facts
from ...run.costs import RunCost
from ...run.identity import Environment
from ...run.manifest import Cells, left_out_sentence
from ...stats.model_result import ModelResult, ValueKey
from ...stats.published.tables import method_of
from ...stats.results import (
    AVERAGE,
    CLEAN,
    LABELS,
    METRIC_LABELS,
    OVERALL,
    benchmark_label,
    long_label,
    mean_label,
    metric_label,
)
from ...stats.run_results import comparison_note
from ..table import Column, Table, TableCell, interval_text, number_text
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
    by_page: dict[str, list[ModelResult]] = {}
    for line, page in content.pages.items():
        by_page.setdefault(page, []).append(line)
    return {page: (plain(lines[0].name), list(_tables(lines, content))) for page, lines in by_page.items()}


def _tables(lines: Sequence[ModelResult], content: Content) -> Iterator[Table]:
    for line in lines:
        if (table := _scores(line, content.cells[line])).columns:
            yield table
    if (run := lines[0].run) is not None:
        for metric in ("epe", "cre", "rcre", "photometric", "spread"):
            if _has_table(lines[0], run, metric):
                yield _severities(lines[0], run, metric)
        facts = _run_facts(run)
    else:
        for benchmark in dict.fromkeys(line.benchmark for line in lines):
            yield _settings(benchmark, [line for line in lines if line.benchmark == benchmark])
        facts = _published_facts(lines)
    rows = [(label, [plain(text, _LONGEST)]) for label, text in facts if text]
    yield Table.of(FACTS, "About this result", [""], {"": rows}, keep_empty=True)


def _scores(line: ModelResult, cells: Mapping[ValueKey, TableCell]) -> Table:
    keys = [key for key in OVERALL if key in cells]
    row = (plain(line.setting, 40), [cells[key] for key in keys], plain(line.note, 300))
    return Table.of(SCORES, benchmark_label(line.benchmark), [mean_label(*key) for key in keys], {"": [row]})


def _has_table(line: ModelResult, run: Run, metric: str) -> bool:
    """Whether a run has a table of this metric; the photometric error only has one without ground truth."""
    if metric in METRIC_LABELS and metric != "photometric":
        return bool(line.numbers(metric))
    return run.mean(metric) is not None and (metric == "spread" or run.epe_clean is None)


def _severities(line: ModelResult, run: Run, metric: str) -> Table:
    levels = run.measured.severities
    rows = []
    for name in run.measured.corruptions:
        mean = TableCell(
            number_text(run.mean(metric, name)), interval=interval_text(line.intervals.get((metric, name)))
        )
        values = (run.mean(metric, name, level) for level in levels)
        rows.append((plain(long_label(name)), [*values, mean]))
    top = scale_top(run.mean(metric, name, level) for level in levels for name in run.measured.corruptions)
    columns = [Column(label, strongest=top) for label in (*map(str, levels), "mean")]
    label = "Standard deviation over draws (px)" if metric == "spread" else metric_label(metric)
    title = f"{label} by severity"
    return Table.of(SHADED, title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


def _settings(benchmark: str, results: Sequence[ModelResult]) -> Table:
    names = ordered({name for r in results for m, name in r.values if m in _METRICS} - {CLEAN, AVERAGE})
    shown = [(m, r) for m in _METRICS for r in results if any((m, name) in r.values for name in names)]
    tops = {metric: scale_top(r.number(metric, name) for _, r in shown for name in names) for metric in _METRICS}
    rows = [
        (
            "Average" if name == AVERAGE else long_label(name),
            [r.values[m, name].text if (m, name) in r.values else None for m, r in shown],
        )
        for name in [*names, AVERAGE]
    ]
    columns = [Column(f"{LABELS[m]} {plain(r.setting, 40)}", strongest=tops[m]) for m, r in shown]
    title = f"{benchmark_label(benchmark)} (px)"
    return Table.of(SHADED, title, columns, {"": rows}, row_header="Corruption", keep_empty=True)


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
            (f"Packages of {counted(sum(map(Cells.count, part.made)), 'earlier row')}", _packages(part))
            for part in manifest.earlier
        ],
    ]


def _packages(environment: Environment) -> str:
    return ", ".join(f"{name} {version}" for name, version in environment.packages.items())


def _published_facts(lines: Sequence[ModelResult]) -> list[tuple[str, str]]:
    """Return the sources of a model's values, and its method if the paper describes it."""
    method = method_of(lines[0].name)
    sources = dict.fromkeys([lines[0].source, *(value.origin for line in lines for value in line.values.values())])
    facts = [("Source", ", ".join(filter(None, sources)))]
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

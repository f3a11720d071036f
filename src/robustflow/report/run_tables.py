"""Terminal tables of finished runs: means by corruption, a single metric, and overall means of several runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from ..analysis.conditions import SeedGroup
from ..analysis.labels import METRIC_LABELS, family_label, metric_label
from ..analysis.model_result import ModelResult
from ..analysis.results import AVERAGE, CLEAN, RESULT_METRICS
from ..analysis.uncoupled import UNCOUPLED, uncoupled
from ..metrics.summary import has_gaps
from .table import Column, Line, Section, Table, full_note, number_text, seed_line

if TYPE_CHECKING:
    from ..runs.run import Run

MEANS = {("epe", CLEAN): "clean EPE (px)"} | {(metric, AVERAGE): metric_label(metric) for metric in RESULT_METRICS}
"""The overall means in tables of runs, with their labels."""
_WITHOUT_TRUTH = ("clean flow (px)", "clean photometric error (grey levels)", "of zero flow")


def corruptions_table(run: Run, title: str) -> Table:
    """Tabulate the means of a run for each corruption, and its EPE (RCRE without ground truth) at each severity."""
    summary = run.summary
    shown = [
        metric
        for metric in ("epe", "cre", "crer", "rcre")
        if any(getattr(scores, metric) is not None for scores in summary.corruptions.values())
    ]
    at_each, levels = "epe" if "epe" in shown else "rcre", summary.severities()
    shown += ["photometric"] * (at_each == "rcre")
    shown += ["coverage"] * has_gaps(summary) + ["spread"] * (summary.spread is not None)
    columns = [Column(METRIC_LABELS.get(metric, metric)) for metric in shown]
    columns += [Column(f"{METRIC_LABELS[at_each]} {level}" if level == levels[0] else str(level)) for level in levels]
    lines = []
    for corruption, scores in summary.corruptions.items():
        values = dict(zip(scores.severities, scores.by_severity[at_each], strict=True))
        means = (getattr(scores, metric) for metric in shown)
        lines.append(Line.of_numbers(corruption, (*means, *map(values.get, levels))))
    texts = (number_text(getattr(summary, metric)) for metric in shown)
    sections = (*_by_family(lines), Section("All", (Line.of("mean", (*texts, *[""] * len(levels))),)))
    return Table("corruptions", title, tuple(columns), sections, row_header="Corruption")


def severities_table(run: Run, metric: str, title: str) -> Table:
    """Tabulate a metric of a run, or one of `UNCOUPLED`, by corruption and severity, with the mean over severities."""
    frame = uncoupled(run.rows).table(metric) if metric in UNCOUPLED else run.table(metric)
    labels = [name for name in frame.columns if name not in ("corruption", "family")]
    rows = frame.iter_rows(named=True)
    lines = [Line.of_numbers(row["corruption"], (row[label] for label in labels)) for row in rows]
    return Table("severities", title, tuple(map(Column, labels)), tuple(_by_family(lines)), row_header="Corruption")


def runs_table(results: Sequence[ModelResult], seeds: Sequence[SeedGroup] = ()) -> Table:
    """Tabulate the overall means of runs; without ground truth, also the mean length and the photometric error of the
    clean flow. For each group in `seeds`, a row with the mean and standard deviation follows the group's last run."""
    without_truth = all(line.number("epe", CLEAN) is None for line in results)
    lines, values = [], {}
    for line in results:
        summary = line.run.summary if line.run and without_truth else None
        clean = (summary.clean_flow_length, summary.clean.photometric, summary.photometric_still) if summary else ()
        values[line.key] = [*(line.number(*key) for key in MEANS), *(clean or [None] * len(_WITHOUT_TRUTH))]
        lines.append(Line.of_numbers(line.name, values[line.key], full_note(line)))
        lines += [seed_line(group, values) for group in seeds if group.runs[-1] == line.key]
    columns = map(Column, (*MEANS.values(), *_WITHOUT_TRUTH))
    table = Table("runs", "Means", tuple(columns), (Section("Runs", tuple(lines)),))
    return table.without_empty_columns()


def _by_family(lines: Iterable[Line]) -> Iterable[Section]:
    """Group the lines of corruptions, which are in the paper's order, by family."""
    for family, of_family in groupby(lines, lambda line: family_label(line.label) or "Others"):
        yield Section(family, tuple(of_family))

"""The page of a model: its numbers under every corruption, facts about the run, and a breakdown of its error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ...core.text import plain
from ...corruptions.registry import ordered
from ...data.benchmarks import benchmark_facts
from ...run.costs import read_cost
from ...run.plan import left_out_sentence
from ...stats.anatomy import severity_slopes
from ...stats.model_result import ModelResult, ValueKey
from ...stats.published.tables import method_of
from ...stats.results import (
    AVERAGE,
    CLEAN,
    METRIC_LABELS,
    OVERALL,
    benchmark_label,
    long_label,
    mean_label,
    metric_label,
    setting_words,
)
from ...stats.run_results import comparison_note
from ..analysis_tables import anatomy_table
from ..table import DASH, Column, Line, Section, Table, TableCell, interval_text
from .content import Content
from .examples import PanelPicture

if TYPE_CHECKING:
    from ...run.run import Run

_LONGEST = 600
_WITHOUT_TRAINING = {"knowledge": "none: not a learned method", "untrained": "none: its weights are random"}
Facts = list[tuple[str, str]]
_METRICS = ("cre", "rcre", "epe")
Tiles = tuple[tuple[ModelResult, tuple[tuple[str, TableCell], ...]], ...]


@dataclass(frozen=True)
class ModelPage:
    """The content of a model's page."""

    id: str
    name: str
    tiles: Tiles
    sentences: tuple[str, ...]
    tables: tuple[Table, ...]
    facts: Facts
    anatomy: Table | None
    panels: tuple[PanelPicture, ...] = ()


def model_pages(content: Content, panels: Mapping[ModelResult, Sequence[PanelPicture]]) -> list[ModelPage]:
    """Build a page for each model of each sample set, in the order of the lines."""
    by_page: dict[str, list[ModelResult]] = {}
    for line, page in content.pages.items():
        by_page.setdefault(page, []).append(line)
    return [
        ModelPage(
            id=page,
            name=plain(lines[0].name),
            tiles=tuple((line, _tiles(content.cells[line])) for line in lines),
            sentences=tuple(sentence for line in lines for sentence in _sentences(line)),
            tables=tuple(_tables(lines)),
            facts=_facts(lines),
            anatomy=_anatomy(lines[0].run) if lines[0].run else None,
            panels=tuple(panels.get(lines[0], ())),
        )
        for page, lines in by_page.items()
    ]


def _tables(lines: Sequence[ModelResult]) -> Iterator[Table]:
    """Yield a table per metric of a run, or a table per benchmark of other results."""
    if (run := lines[0].run) is not None:
        for metric in (*_METRICS, "photometric", "spread"):
            if _has_table(lines[0], run, metric):
                yield _severity_table(lines[0], run, metric)
        return
    for benchmark in dict.fromkeys(line.benchmark for line in lines):
        yield _settings_table(benchmark_label(benchmark), [line for line in lines if line.benchmark == benchmark])


def _facts(lines: Sequence[ModelResult]) -> Facts:
    """Return facts about a run, or about the sources of other results, as (label, text) pairs."""
    facts = _run_facts(lines[0].run) if lines[0].run else _published_facts(lines)
    return [(label, plain(text, _LONGEST)) for label, text in facts if text]


def _run_facts(run: Run) -> Facts:
    """Return facts about a run from its manifest: model, data, seed, versions, omitted data, and differences from the
    paper."""
    manifest, provenance = run.manifest, run.provenance
    frames, published = manifest.identity.frames, benchmark_facts(run.benchmark).published
    return [
        ("Source", f"verified record {run.record}" if run.record else "measured"),
        ("Model", _described(manifest.identity.model.settings)),
        ("Setting", run.setting),
        ("Trained on", _trained_on(run.setting, provenance.trained_on)),
        ("Pre-trained backbone", provenance.backbone),
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
        ("Packages", ", ".join(f"{name} {version}" for name, version in manifest.environment.packages.items())),
    ]


def _published_facts(lines: Sequence[ModelResult]) -> Facts:
    """Return facts about a model from the paper or a results file: its method, and the tables that contain its
    values."""
    method = method_of(lines[0].name)
    sources = dict.fromkeys([lines[0].source, *(value.source for line in lines for value in line.values.values())])
    facts = [("Source", ", ".join(filter(None, sources)))]
    if method is not None:
        facts += [
            ("Method", f"{method.method} ({method.type}, {method.year})"),
            ("Encoder", method.encoder),
            ("Decoder", method.decoder),
        ]
    return facts


def _trained_on(setting: str, names: Sequence[str] | None) -> str:
    if setting in _WITHOUT_TRAINING:
        return _WITHOUT_TRAINING[setting]
    return "not declared" if names is None else ", ".join(names) or "nothing"


def _described(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}: {value}" for key, value in values.items() if value not in ({}, None, ""))


def _cost(run: Run) -> str:
    cost = read_cost(run)
    if cost is None:
        return ""
    size = f"{cost.parameters_m:.2f} M parameters, {cost.flops_g:.1f} G FLOPs for {cost.width} x {cost.height} frames"
    return size + (f", {cost.seconds:.3f} s on {cost.device}" if cost.seconds is not None else "")


def _tiles(cells: Mapping[ValueKey, TableCell]) -> tuple[tuple[str, TableCell], ...]:
    return tuple((mean_label(*key), cells[key]) for key in OVERALL if key in cells)


def _sentences(line: ModelResult) -> tuple[str, ...]:
    """Name the corruptions under which the model is worst and best."""
    for metric in ("cre", "rcre"):
        numbers = line.numbers(metric)
        values = {name: numbers[name] for name in ordered(numbers.keys() - {CLEAN, AVERAGE})}
        if len(values) < 2:
            continue
        order = sorted(values, key=lambda name: -values[name])
        sign = "+" if metric == "cre" else ""
        named = [f"{long_label(name)} ({values[name]:{sign}.2f} px)" for name in order]
        worst = named[:-1][:3]
        are = "corruption is" if len(worst) == 1 else "corruptions are"
        where = f"{benchmark_label(line.benchmark)}, {setting_words(line.setting)}"
        return (
            f"{where}: by {METRIC_LABELS[metric]}, the worst {are} {', '.join(worst)}; the mildest is {named[-1]}.",
        )
    return ()


def _has_table(line: ModelResult, run: Run, metric: str) -> bool:
    """Return whether a run has a table of this metric; the photometric error only has one without ground truth."""
    if metric in METRIC_LABELS and metric != "photometric":
        return bool(line.numbers(metric))
    return run.mean(metric) is not None and (metric == "spread" or run.epe_clean is None)


def _severity_table(line: ModelResult, run: Run, metric: str) -> Table:
    table = run.table(metric)
    levels = [column for column in table.columns if column.isdigit()]
    top = scale_top(value for level in levels for value in table[level])
    slopes = severity_slopes(run.averages, metric)
    lines = []
    for row in table.iter_rows(named=True):
        cells = [TableCell(_number(row[level])) for level in levels]
        interval = interval_text(line.intervals.get((metric, row["corruption"])))
        cells.append(TableCell(_number(row["mean"]), interval=interval))
        if slopes:
            cells.append(TableCell(_number(slopes.get(row["corruption"]))))
        lines.append(Line(plain(long_label(row["corruption"])), tuple(cells)))
    columns = [Column(label, strongest=top) for label in (*levels, "mean")]
    columns += [Column("slope")] if slopes else []
    label = "Standard deviation over draws (px)" if metric == "spread" else metric_label(metric)
    return _table(f"{label} by severity", columns, lines)


def _settings_table(title: str, results: Sequence[ModelResult]) -> Table:
    names = ordered({name for r in results for m, name in r.values if m in _METRICS} - {CLEAN, AVERAGE})
    shown = [(m, r) for m in _METRICS for r in results if any((m, name) in r.values for name in names)]
    tops = {metric: scale_top(r.number(metric, name) for _, r in shown for name in names) for metric in _METRICS}
    lines = []
    for name in [*names, AVERAGE]:
        cells = tuple(TableCell(r.values[m, name].text if (m, name) in r.values else "–") for m, r in shown)
        lines.append(Line("Average" if name == AVERAGE else long_label(name), cells))
    columns = [Column(f"{METRIC_LABELS[m]} {setting_words(r.setting)}", strongest=tops[m]) for m, r in shown]
    return _table(f"{title} (px)", columns, lines)


def _table(title: str, columns: Sequence[Column], lines: Sequence[Line]) -> Table:
    return Table("model", title, tuple(columns), (Section("", tuple(lines)),), row_header="Corruption")


def _anatomy(run: Run) -> Table | None:
    """Return the parts of the anatomy table about regions and families. Slopes are omitted because the severity tables
    show them."""
    whole = anatomy_table([run])
    lines = [line for line in whole.lines if any(cell.text != DASH for cell in line.cells[:2])]
    if not lines:
        return None
    without_slope = tuple(Line(line.label, line.cells[:-1]) for line in lines)
    remarks = tuple(remark.partition("; slope: ")[0] + "." for remark in whole.remarks)
    return replace(whole, columns=whole.columns[:-1], sections=(Section("", without_slope),), remarks=remarks)


def scale_top(values: Iterable[float | None]) -> float:
    """Return the value of the strongest colour: the 95th percentile, so that one outlier does not make all other cells
    pale. The page's script divides the range into steps.

    >>> scale_top([1.0, None, 2.0, -3.0])
    3.0
    """
    known = sorted(abs(value) for value in values if value is not None)
    return known[min(len(known) - 1, int(0.95 * len(known)))] if known else 0.0


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"

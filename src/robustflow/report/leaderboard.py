"""The leaderboard: one table per benchmark, of which a page shows selected columns and rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ..core.text import plain
from ..corruptions.registry import MEMBERS
from ..data.benchmarks.facts import is_still
from ..stats.exclusion import CAVEAT, PHANTOM
from ..stats.intervals import paper_rows
from ..stats.model_result import CRER, FLOPS, PARAMETERS, RANKS, ModelResult, Value, ValueKey, by_frames
from ..stats.ranking import best_of_columns
from ..stats.results import (
    AVERAGE,
    CLEAN,
    FAMILY_LABELS,
    LABELS,
    benchmark_label,
    long_label,
    short_label,
)
from ..stats.verdict import Verdict, verdict_of
from .table import DASH, Column, Line, Section, Table, TableCell, interval_text

COVERAGE: ValueKey = ("coverage", "")
GROUP: ValueKey = ("group", "")
EPE: ValueKey = ("epe", AVERAGE)

START: tuple[ValueKey, ...] = (EPE, ("rcre", AVERAGE), ("epe", CLEAN))
"""Initial sort keys: the EPE under corruption, or the RCRE without ground truth. Sorting by CRE would put the
knowledge-driven methods first because their clean error is already high."""

OVERVIEW, COMPACT, CLASSES = "overview", "compact", "classes"
"""Names of the views besides the families; the compact one fits next to the names on a phone screen."""
BOARD_METRICS = ("epe", "cre", "rcre")
MOST_COMPARED = 20
"""Maximum number of models of a setting that are tested against each other and have a group letter."""

_OVERVIEW_COLUMNS = tuple(
    Column(label, key=key, help=help, unit=unit, views=views)
    for key, label, help, unit, *views in (
        (GROUP, "Group", "Models of a setting that share a letter cannot be told apart by their EPE", "", OVERVIEW),
        (("epe", CLEAN), "Clean EPE", "End-point error on the clean frames", "px", OVERVIEW),
        (EPE, "EPE", "End-point error, mean over all corruptions", "px", OVERVIEW, COMPACT),
        (("cre", AVERAGE), "CRE", "Corruption Robustness Error: EPE - clean EPE", "px", OVERVIEW, COMPACT),
        (CRER, "CREr", "CRE / clean EPE", "", OVERVIEW),
        (("rcre", AVERAGE), "RCRE", "Change in the flow under corruption", "px", OVERVIEW, COMPACT),
        (("flow_length", CLEAN), "Flow", "Mean length of the flow on the clean frames", "px", OVERVIEW),
        (("photometric", CLEAN), "Clean photom.", "Photometric error on the clean frames", "grey", OVERVIEW),
        (("photometric", AVERAGE), "Photom.", "Photometric error under corruption", "grey", OVERVIEW),
        (("photometric_still", CLEAN), "of zero flow", "Photometric error of a flow that is zero", "grey", OVERVIEW),
        (
            COVERAGE,
            "Coverage",
            "Share of the pixels that the model predicted; errors are over these pixels",
            "",
            OVERVIEW,
        ),
        (PARAMETERS, "Param.", "Parameters, millions", "M", OVERVIEW),
        (
            FLOPS,
            "MACs",
            "Multiply-accumulates by thop, the paper's FLOPs, 10⁹",
            "G",
            OVERVIEW,
        ),
        (RANKS["average"], "Avg. rank", "Rank by the mean of the MACs and CREr ranks (Tab. 3)", "", OVERVIEW),
    )
)
Cells = dict[ValueKey, TableCell]
Setting = tuple[str, str, str]
"""Benchmark, sample set and setting: what models have in common that are ranked together."""


def boards_of(cells: Mapping[ModelResult, Cells], group_titles: Mapping[str, str]) -> list[Table]:
    """Build one board per benchmark from `board_cells`, named after it, ordered by number of runs, then by number of
    models. It has one section per set of frames, with lines in the order of `by_error`."""
    of_benchmark: dict[str, dict[ModelResult, Cells]] = {}
    for line, of_line in cells.items():
        of_benchmark.setdefault(line.benchmark, {})[line] = of_line

    def place(lines: Mapping[ModelResult, object]) -> tuple[int, int]:
        return -sum(line.run is not None for line in lines), -len({plain(line.name) for line in lines})

    order = sorted(of_benchmark.items(), key=lambda item: place(item[1]))
    return [_board(name, of_lines, group_titles) for name, of_lines in order]


def board_cells(
    results: Sequence[ModelResult], verdicts: Mapping[Setting, Verdict] | None = None
) -> dict[ModelResult, Cells]:
    """Return the marked cells of each line and its group: models of one setting on the same frames share a letter
    unless a paired test, corrected for all pairs, tells their EPE apart."""
    known = verdicts_of(results) if verdicts is None else verdicts
    cells = {}
    for line, of_line in marked_cells(results).items():
        letters = known[setting_of(line)].letters if line.run is not None and setting_of(line) in known else {}
        cells[line] = of_line | ({GROUP: TableCell(letters[line.name])} if line.name in letters else {})
    return cells


def setting_of(line: ModelResult) -> Setting:
    """Return what models have in common that are ranked together."""
    return line.benchmark, line.frames, line.setting


def verdicts_of(results: Sequence[ModelResult]) -> dict[Setting, Verdict]:
    """Return the verdict on the ranked runs of each setting, of those with the lowest error under corruption."""
    ranked: dict[Setting, list[ModelResult]] = {}
    for line in results:
        if line.run is not None and not line.excluded and any(key in line.values for key in START[:2]):
            ranked.setdefault(setting_of(line), []).append(line)
    verdicts = {}
    for setting, lines in ranked.items():
        best = sorted(lines, key=by_error)[:MOST_COMPARED]
        runs = {line.name: (line.run, line.beside_published) for line in best if line.run is not None}
        verdicts[setting] = verdict_of(
            {name: paper_rows(run) if few else run.rows for name, (run, few) in runs.items()}
        )
    return verdicts


def by_error(line: ModelResult) -> tuple[bool, bool, float, str]:
    """Sort lines by `START`, then by name; models without a rank come last."""
    value = next((number for key in START if (number := line.number(*key)) is not None), None)
    return bool(line.excluded), value is None, value or 0.0, plain(line.name)


def marked_cells(results: Sequence[ModelResult]) -> dict[ModelResult, Cells]:
    """Return the cells of each line, of which the best are marked (`ModelResult.may_be_best`) among lines of the same
    setting on the same frames. Numbers that the paper does not print are not marked."""
    values = {line: _values(line) for line in results}
    compared = []
    for line, of_line in values.items():
        texts = {
            key: value.text
            for key, value in of_line.items()
            if key not in (PARAMETERS, FLOPS, COVERAGE) and line.may_be_best(key[0]) and not _is_derived(line, key)
        }
        compared.append(None if line.excluded else ((line.benchmark, line.frames, line.setting), texts))
    return {
        line: {
            key: TableCell(value.text, key in best, interval_text(value.ends), derived=_is_derived(line, key))
            for key, value in of_line.items()
        }
        for (line, of_line), best in zip(values.items(), best_of_columns(compared), strict=True)
    }


def _values(line: ModelResult) -> dict[ValueKey, Value]:
    """Return what a board shows of a line."""
    shown = {key: value for key, value in line.values.items() if key not in (RANKS["flops"], RANKS["crer"])}
    shown |= {key: value for key, value in line.families.items() if key[0] in BOARD_METRICS}
    return shown if line.coverage is None else shown | {COVERAGE: Value(line.coverage)}


def _is_derived(line: ModelResult, key: ValueKey) -> bool:
    """Whether a value of the paper's lines is computed from others, because the paper does not print it."""
    return key == CRER and line.source == "published" and line.values[CRER].derived


def _board(benchmark: str, cells: Mapping[ModelResult, Cells], group_titles: Mapping[str, str]) -> Table:
    keys = {key for of_line in cells.values() for key in of_line}
    columns = [column for column in _OVERVIEW_COLUMNS if column.key in keys]
    few = [column for column in columns if COMPACT in column.views][:2]
    columns = [column if column in few else replace(column, views=(OVERVIEW,)) for column in columns]
    for metric in BOARD_METRICS:
        families = [family for family in MEMBERS if (metric, family) in keys]
        if families and (metric, AVERAGE) in keys:
            columns.append(_column(metric, AVERAGE, f"AVG {LABELS[metric]}", "all corruptions", CLASSES))
        for family in families:
            columns.append(_column(metric, family, FAMILY_LABELS[family], "the class", CLASSES, family))
            for name in MEMBERS[family]:
                if (metric, name) in keys:
                    columns.append(_column(metric, name, short_label(name), long_label(name), family))
    hidden = sorted(keys - {column.key for column in columns})
    columns += [Column(" ".join(filter(None, key)), key=key) for key in hidden]
    sections = []
    for frames, lines in by_frames(cells).items():
        in_order = []
        for line in sorted(lines, key=by_error):
            of_line = tuple(cells[line].get(column.key, TableCell(DASH)) for column in columns)
            in_order.append(Line(line.name, of_line, line.note, result=line))
        sections.append(Section(group_titles.get(frames, plain(frames, 200)), tuple(in_order)))
    remarks = tuple(_remarks(benchmark, cells))
    return Table(benchmark, benchmark_label(benchmark), tuple(columns), tuple(sections), remarks)


def _column(metric: str, condition: str, label: str, over: str, *views: str) -> Column:
    return Column(label, key=(metric, condition), help=f"{LABELS[metric]}, {over}", unit="px", views=views)


def _remarks(benchmark: str, cells: Mapping[ModelResult, Cells]) -> Iterator[str]:
    every = [cell for of_line in cells.values() for cell in of_line.values()]
    runs = [line for line in cells if line.run is not None]
    if any(cell.best for cell in every):
        yield (
            "Bold: lowest value among learned models in the same setting on the same frames; of runs, only the EPE, "
            "because a flow that is too short has a low CRE, CREr and RCRE."
        )
    if any(GROUP in of_line for of_line in cells.values()):
        yield (
            "Group: models of a setting that share a letter cannot be told apart (paired tests of the EPE, corrected "
            f"for all pairs of the {MOST_COMPARED} lowest). An order within a group can be chance."
        )
    if any(cell.derived for cell in every):
        yield "Italic: CREr that the paper does not print, from other values of the row."
    if any(line.intervals for line in runs):
        yield "Brackets: 95 % confidence intervals over images (over sequences where there are any)."
    elif runs:
        yield "No confidence intervals: too few images or sequences."
    if len({line.frames for line in cells}) > 1:
        yield "Rows are sorted within each group."
    if is_still(benchmark):
        yield PHANTOM
    elif runs and all(("epe", CLEAN) not in line.values for line in runs):
        yield CAVEAT

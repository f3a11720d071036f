"""The leaderboard: one table per benchmark, of which a page shows selected columns and rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ..core.text import plain
from ..corruptions.registry import MEMBERS
from ..data.benchmarks.facts import is_still
from ..metrics.cube import PAPER, MeanKey
from ..metrics.measures import EVERY
from ..metrics.regions import REGIONS
from ..stats.exclusion import CAVEAT, PHANTOM
from ..stats.frame import ERRORS, MOST_COMPARED
from ..stats.lines import FLOPS, PARAMETERS, RANKS, LineKey, Lines, Numbers, by_sample_set
from ..stats.ranking import best_of_columns
from ..stats.results import (
    AVERAGE,
    CLEAN,
    FAMILY_LABELS,
    LABELS,
    RESULT_METRICS,
    UNITS,
    benchmark_label,
    long_label,
    short_label,
)
from .table import DASH, Column, Line, Section, Table, TableCell, cell_of

COVERAGE: MeanKey = ("coverage", "", None)
GROUP: MeanKey = ("group", "", None)
START: tuple[MeanKey, ...] = tuple((*key, None) for key in ERRORS)
"""Initial sort keys of boards."""

EPE, _, EPE_CLEAN = START

OVERVIEW, COMPACT, CLASSES = "overview", "compact", "classes"
"""Names of the views besides the families; the compact one fits next to the names on a phone screen."""
BOARD_METRICS = ("epe", "cre", "rcre")

_FEW, _ALL = (OVERVIEW, COMPACT), (OVERVIEW,)


def _over(metric: str, condition: str, label: str, views: Sequence[str] = _ALL, unit: str = "px") -> Column:
    """Return a column of the overview, explained as the measure is."""
    where = {CLEAN: " on the clean frames", AVERAGE: ", mean over all corruptions"}[condition]
    return Column(
        label, key=(metric, condition, None), help=f"{EVERY[metric].explanation}{where}", unit=unit, views=views
    )


_OVERVIEW_COLUMNS = (
    Column(
        "Group",
        key=GROUP,
        help="Models of a setting that share a letter cannot be told apart by their EPE",
        views=_ALL,
    ),
    _over("epe", CLEAN, "Clean EPE"),
    _over("epe", AVERAGE, "EPE", _FEW),
    _over("cre", AVERAGE, "CRE", _FEW),
    _over("crer", AVERAGE, "CREr", unit=""),
    _over("rcre", AVERAGE, "RCRE", _FEW),
    _over("flow_length", CLEAN, "Flow"),
    _over("photometric", CLEAN, "Clean photom.", unit="grey"),
    _over("photometric", AVERAGE, "Photom.", unit="grey"),
    _over("photometric_still", CLEAN, "of zero flow", unit="grey"),
    Column(
        "Coverage",
        key=COVERAGE,
        help="Share of the pixels that the model predicted; errors are over these pixels",
        views=_ALL,
    ),
    Column("Param.", key=PARAMETERS, help="Parameters, millions", unit="M", views=_ALL),
    Column("MACs", key=FLOPS, help="Multiply-accumulates by thop, the paper's FLOPs, 10⁹", unit="G", views=_ALL),
    Column("Avg. rank", key=RANKS["average"], help="Rank by the mean of the MACs and CREr ranks (Tab. 3)", views=_ALL),
)
_WITHOUT_TRUTH = [
    column.key for column in _OVERVIEW_COLUMNS if column.key[0] in ("flow_length", "photometric", "photometric_still")
]
Cells = dict[MeanKey, TableCell]


def boards_of(lines: Lines, group_titles: Mapping[str, str], asked: str = "") -> list[Table]:
    """Build one board per benchmark, named after it, ordered by number of runs, then by number of models. It has one
    section per set of frames, with lines in the order of `by_error`, and a column of the measure that is asked for."""
    of_benchmark: dict[str, dict[LineKey, Numbers]] = {}
    for key, numbers in lines.items():
        of_benchmark.setdefault(key.benchmark, {})[key] = numbers

    def place(part: Lines) -> tuple[int, int]:
        return -sum(numbers.is_run for numbers in part.values()), -len({plain(key.model) for key in part})

    order = sorted(of_benchmark.items(), key=lambda item: place(item[1]))
    return [_board(name, part, group_titles, asked) for name, part in order]


def by_error(line: tuple[LineKey, Numbers]) -> tuple[bool, bool, float, str]:
    """Sort lines by `START`, then by name; models without a rank come last."""
    key, numbers = line
    value = next((numbers[of]["value"] for of in START if of in numbers), None)
    return bool(numbers.fact("excluded")), value is None, value or 0.0, plain(key.model)


def marked_cells(lines: Lines) -> dict[LineKey, Cells]:
    """Return the cells of each line, over severities. The best are marked (`Numbers.may_be_best`) among lines of the
    same setting on the same frames. Numbers that the paper does not print are not marked."""
    cells = {key: {of: cell_of(row) for of, row in numbers.items() if of[2] is None} for key, numbers in lines.items()}
    compared = []
    for key, of_line in cells.items():
        texts = {
            of: cell.text
            for of, cell in of_line.items()
            if of not in (PARAMETERS, FLOPS, COVERAGE) and lines[key].may_be_best(key, of[0]) and not cell.derived
        }
        compared.append(None if lines[key].fact("excluded") else (key.comparable, texts))
    return {
        key: {of: replace(cell, best=of in best) for of, cell in of_line.items()}
        for (key, of_line), best in zip(cells.items(), best_of_columns(compared), strict=True)
    }


def board_cells(lines: Lines, asked: str = "") -> dict[LineKey, Cells]:
    """Return what a board shows of each line: its marked cells, its group and its coverage. Models of one setting on
    the same frames share a letter unless a paired test, corrected for all pairs, tells their EPE apart."""
    wanted = {column.key for column in _OVERVIEW_COLUMNS} | {(asked, AVERAGE, None)}
    of_run = {CLEAN, PAPER, *REGIONS}
    cells = {}
    for key, of_line in marked_cells(lines).items():
        numbers = lines[key]
        unneeded = _WITHOUT_TRUTH if EPE_CLEAN in numbers else ()
        shown = {
            of: cell
            for of, cell in of_line.items()
            if of not in unneeded
            and (of in wanted or (of[0] in RESULT_METRICS and not (numbers.is_run and of[1] in of_run)))
            and (of[0] in BOARD_METRICS or of[1] not in MEMBERS)
        }
        letter = numbers[EPE]["letter"] if EPE in numbers else None
        shown |= {GROUP: TableCell(letter)} if letter else {}
        shown |= {COVERAGE: TableCell(f"{numbers.coverage:.2f}")} if numbers.coverage is not None else {}
        cells[key] = shown
    return cells


def _board(benchmark: str, lines: Lines, group_titles: Mapping[str, str], asked: str) -> Table:
    cells = board_cells(lines, asked)
    keys = {key for of_line in cells.values() for key in of_line}
    columns = [column for column in _OVERVIEW_COLUMNS if column.key in keys]
    if (asked, AVERAGE, None) in keys - {column.key for column in columns}:
        place = 1 + max((at for at, column in enumerate(columns) if column.key[1] == AVERAGE), default=-1)
        columns.insert(place, _over(asked, AVERAGE, LABELS[asked], unit=UNITS[asked]))
    few = [column for column in columns if COMPACT in column.views][:2]
    columns = [column if column in few else replace(column, views=(OVERVIEW,)) for column in columns]
    for metric in BOARD_METRICS:
        families = [family for family in MEMBERS if (metric, family, None) in keys]
        if families and (metric, AVERAGE, None) in keys:
            columns.append(_column(metric, AVERAGE, f"AVG {LABELS[metric]}", "all corruptions", CLASSES))
        for family in families:
            columns.append(_column(metric, family, FAMILY_LABELS[family], "the class", CLASSES, family))
            for name in MEMBERS[family]:
                if (metric, name, None) in keys:
                    columns.append(_column(metric, name, short_label(name), long_label(name), family))
    hidden = sorted(key[:2] for key in keys - {column.key for column in columns})
    columns += [Column(" ".join(filter(None, key)), key=(*key, None)) for key in hidden]
    sections = []
    for sample_set, part in by_sample_set(lines).items():
        in_order = []
        for key, numbers in sorted(part.items(), key=by_error):
            of_line = tuple(cells[key].get(column.key, TableCell(DASH)) for column in columns)
            in_order.append(Line(key.model, of_line, numbers.fact("note"), result=key))
        sections.append(Section(group_titles.get(sample_set, plain(sample_set, 200)), tuple(in_order)))
    remarks = tuple(_remarks(benchmark, lines, cells))
    return Table(benchmark, benchmark_label(benchmark), tuple(columns), tuple(sections), remarks)


def _column(metric: str, condition: str, label: str, over: str, *views: str) -> Column:
    return Column(label, key=(metric, condition, None), help=f"{LABELS[metric]}, {over}", unit="px", views=views)


def _remarks(benchmark: str, lines: Lines, cells: Mapping[LineKey, Cells]) -> Iterator[str]:
    every = [cell for of_line in cells.values() for cell in of_line.values()]
    runs = [numbers for numbers in lines.values() if numbers.is_run]
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
    if any(cell.interval for key, of_line in cells.items() if lines[key].is_run for cell in of_line.values()):
        yield "Brackets: 95 % confidence intervals over images (over sequences where there are any)."
    elif runs:
        yield "No confidence intervals: too few images or sequences."
    if len({key.sample_set for key in lines}) > 1:
        yield "Rows are sorted within each group."
    if is_still(benchmark):
        yield PHANTOM
    elif runs and all(EPE_CLEAN not in numbers for numbers in runs):
        yield CAVEAT

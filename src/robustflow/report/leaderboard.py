"""The leaderboard: one table per benchmark, of which a page shows selected columns and rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from ..core.text import plain
from ..corruptions.registry import MEMBERS
from ..stats.best import Compared, best_of_columns
from ..stats.cost_ranks import printed_cost_ranks
from ..stats.model_result import ModelResult, PrintedCost, Value, ValueKey, by_frames
from ..stats.published.tables import PAPER
from ..stats.ranking import competition_ranks
from ..stats.results import (
    AVERAGE,
    CLEAN,
    FAMILY_LABELS,
    METRIC_LABELS,
    SETTING_EXPLANATIONS,
    SETTING_LABELS,
    benchmark_label,
    family_means,
    long_label,
    setting_words,
    short_label,
)
from .table import DASH, Column, Line, Section, Table, TableCell, interval_text

COVERAGE: ValueKey = ("coverage", "")
PARAMETERS: ValueKey = ("parameters", "")
FLOPS: ValueKey = ("flops", "")
PLACE: ValueKey = ("place", "")
RANK: ValueKey = ("rank", "")
CRER: ValueKey = ("crer", AVERAGE)

START: tuple[ValueKey, ...] = (("epe", AVERAGE), ("rcre", AVERAGE), ("epe", CLEAN))
"""Initial sort keys: the EPE under corruption, or the RCRE without ground truth. Sorting by CRE would put the
knowledge-driven methods first because their clean error is already high."""

OVERVIEW = "overview"
COMPACT = "compact"
"""Columns that fit next to the names on a phone screen."""

CLASSES = "classes"
BOARD_METRICS = ("epe", "cre", "rcre")


@dataclass(frozen=True, kw_only=True)
class BoardColumn(Column):
    """A column of a leaderboard."""

    key: ValueKey
    explanation: str = ""
    views: tuple[str, ...] = ()
    metric: str = ""
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Board(Table):
    """The leaderboard of a benchmark: one section per set of frames, with lines in the order of `by_error`. The remarks
    explain the formatting of the cells.
    """

    benchmark: str
    columns: tuple[BoardColumn, ...]
    views: tuple[tuple[str, str], ...]
    metrics: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str, str], ...]
    start: int

    @property
    def shown(self) -> list[BoardColumn]:
        """The columns that belong to a view."""
        return [column for column in self.columns if column.views]

    def cells_of(self, line: Line) -> dict[ValueKey, TableCell]:
        """Return the cells of a line that contain numbers, by column key."""
        cells = zip(self.columns, line.cells, strict=True)
        return {column.key: cell for column, cell in cells if cell.text != DASH}


_OVERVIEW = (
    (PLACE, "Rank", "Rank by EPE under corruption among the models measured on the same frames", ""),
    (("epe", CLEAN), "Clean EPE", "End-point error on the clean frames", "px"),
    (("epe", AVERAGE), "EPE", "End-point error, mean over all corruptions", "px"),
    (("cre", AVERAGE), "CRE", "Corruption Robustness Error: EPE - clean EPE", "px"),
    (CRER, "CREr", "CRE / clean EPE", ""),
    (("rcre", AVERAGE), "RCRE", "Change in the flow under corruption", "px"),
    (COVERAGE, "Coverage", "Share of the pixels that the model predicted; errors are computed over these pixels", ""),
    (PARAMETERS, "Param.", "Parameters, millions", "M"),
    (FLOPS, "FLOPs", "Floating-point operations of one prediction, 10⁹", "G"),
    (RANK, "Avg. rank", "Rank by the mean of the FLOPs and CREr ranks (Tab. 3)", ""),
)
_COMPACT: tuple[ValueKey, ...] = (("epe", AVERAGE), ("cre", AVERAGE), ("rcre", AVERAGE))


def boards_of(results: Sequence[ModelResult], group_titles: Mapping[str, str]) -> list[Board]:
    """Build one board per benchmark, ordered by number of runs, then by number of models."""
    of_benchmark: dict[str, dict[ModelResult, dict[ValueKey, TableCell]]] = {}
    for line, cells in _cells(results).items():
        of_benchmark.setdefault(line.benchmark, {})[line] = cells

    def place(lines: Mapping[ModelResult, object]) -> tuple[int, int]:
        return -sum(line.run is not None for line in lines), -len({plain(line.name) for line in lines})

    order = sorted(of_benchmark.items(), key=lambda item: place(item[1]))
    return [_board(name, cells, group_titles) for name, cells in order]


def by_error(line: ModelResult) -> tuple[bool, bool, float, str]:
    """Sort lines by `START`, then by name; models without a rank come last."""
    value = next((number for key in START if (number := line.number(*key)) is not None), None)
    return bool(line.excluded), value is None, value or 0.0, plain(line.name)


def _cells(results: Sequence[ModelResult]) -> dict[ModelResult, dict[ValueKey, TableCell]]:
    """Build the cells of each line and mark the best ones (`ModelResult.may_be_best`). Numbers that the paper does not
    print are not marked."""
    ranks = printed_cost_ranks(results)
    values, compared, derived = {}, [], {}
    for line in results:
        values[line] = {
            **line.values,
            **{
                (metric, family): Value(mean)
                for metric in BOARD_METRICS
                for family, mean in family_means(line.numbers(metric)).items()
            },
            **_numbers({CRER: line.crer, COVERAGE: line.coverage}),
        }
        printed: dict[ValueKey, Value] = {}
        if line.printed_cost is not None:
            printed = _published(line, line.printed_cost, ranks)
        elif line.cost is not None:
            printed = _cost(line.cost.parameters_m, line.cost.flops_g, None)
        values[line] |= printed
        derived[line] = {CRER} if line.frames == PAPER and CRER not in printed else set()
        unmarked = {PARAMETERS, FLOPS, COVERAGE, *derived[line]}
        texts = {
            key: value.text for key, value in values[line].items() if key not in unmarked and line.may_be_best(key[0])
        }
        compared.append(Compared((line.benchmark, line.frames, line.setting), texts, bool(line.excluded)))
    for line, place in _places(results).items():
        values[line] |= {PLACE: Value(place, 0)}
    return {
        line: {
            key: TableCell(
                value.text, key in best, interval_text(line.intervals.get(key)), derived=key in derived[line]
            )
            for key, value in values[line].items()
        }
        for line, best in zip(results, best_of_columns(compared), strict=True)
    }


def _published(line: ModelResult, cost: PrintedCost, ranks: Mapping[str, Mapping[str, int]]) -> dict[ValueKey, Value]:
    setting = line.setting.lower()
    if setting not in ("ood", "id"):
        return _cost(cost.parameters_m, cost.flops_g, None)
    rank = ranks[f"average_{setting}"].get(line.name)
    return _cost(cost.parameters_m, cost.flops_g, rank) | _numbers({CRER: getattr(cost, f"crer_{setting}")})


def _cost(parameters: float, flops: float, rank: int | None) -> dict[ValueKey, Value]:
    return {PARAMETERS: Value(parameters), FLOPS: Value(flops, 1), **_numbers({RANK: rank}, 0)}


def _numbers(numbers: Mapping[ValueKey, float | None], decimals: int | None = None) -> dict[ValueKey, Value]:
    return {key: Value(number, decimals) for key, number in numbers.items() if number is not None}


def _places(results: Sequence[ModelResult]) -> dict[ModelResult, int]:
    """Rank each run by its EPE under corruption among the ranked runs on the same frames, in all settings. Equal
    printed values share a rank."""
    key = START[0]
    groups: dict[tuple[str, str], dict[ModelResult, float]] = {}
    for line in results:
        if line.run is not None and not line.excluded and key in line.values:
            groups.setdefault((line.benchmark, line.frames), {})[line] = float(line.values[key].text)
    ranks = (competition_ranks(group) for group in groups.values() if len(group) > 1)
    return {line: rank for group in ranks for line, rank in group.items()}


def _board(
    benchmark: str, cells: Mapping[ModelResult, Mapping[ValueKey, TableCell]], group_titles: Mapping[str, str]
) -> Board:
    keys = {key for of_line in cells.values() for key in of_line}
    overview = [
        BoardColumn(label, key=key, explanation=explanation, views=(OVERVIEW,), unit=unit)
        for key, label, explanation, unit in _OVERVIEW
        if key in keys
    ]
    few = [column.key for column in overview if column.key in _COMPACT][:2]
    columns = [replace(column, views=(OVERVIEW, COMPACT)) if column.key in few else column for column in overview]
    metrics = [metric for metric in BOARD_METRICS if any((metric, family) in keys for family in MEMBERS)]
    families = [family for family in MEMBERS if any((metric, family) in keys for metric in metrics)]
    for metric in metrics:
        if (metric, AVERAGE) in keys:
            columns.append(_mean_column(metric, AVERAGE, f"AVG {METRIC_LABELS[metric]}", (CLASSES,)))
        for family in families:
            columns.append(_mean_column(metric, family, FAMILY_LABELS[family], (CLASSES, family)))
            columns += [_column(metric, name, family) for name in MEMBERS[family] if (metric, name) in keys]
    views = [(OVERVIEW, "Overview")] + [(COMPACT, "Compact")] * (len(columns) > len(few))
    views += [(CLASSES, "Class means")] * bool(families)
    start = next((i for key in START for i, column in enumerate(columns) if column.key == key), 0)
    hidden = sorted(keys - {column.key for column in columns})
    columns += [BoardColumn(" ".join(filter(None, key)), key=key) for key in hidden]
    sections = []
    for frames, lines in by_frames(cells).items():
        in_order = []
        for line in sorted(lines, key=by_error):
            of_line = tuple(cells[line].get(column.key, TableCell(DASH)) for column in columns)
            in_order.append(Line(line.name, of_line, line.note, result=line))
        sections.append(Section(group_titles.get(frames, plain(frames, 200)), tuple(in_order)))
    settings = dict.fromkeys(plain(line.setting, 40) for line in cells)
    return Board(
        name="leaderboard",
        title=benchmark_label(benchmark),
        columns=tuple(columns),
        sections=tuple(sections),
        remarks=tuple(_remarks(cells)),
        benchmark=benchmark,
        views=(*views, *((family, FAMILY_LABELS[family]) for family in families)),
        metrics=tuple((metric, METRIC_LABELS[metric]) for metric in metrics),
        settings=tuple(
            (name, setting_words(name), SETTING_EXPLANATIONS.get(name, ""))
            for name in dict.fromkeys([*SETTING_LABELS, *settings])
            if name in settings
        ),
        start=start,
    )


def _remarks(cells: Mapping[ModelResult, Mapping[ValueKey, TableCell]]) -> Iterator[str]:
    every = [cell for of_line in cells.values() for cell in of_line.values()]
    if any(cell.best for cell in every):
        yield (
            "Bold values are the best in their column among models in the same setting measured on the same frames. Of "
            "runs, only the EPE is marked, because a flow that is too short has a low CRE, CREr and RCRE. "
            "Knowledge-driven methods are not marked."
        )
    if any(cell.derived for cell in every):
        yield "In italics: CREr values that the paper does not print, computed from other values in the same row."
    if any(line.intervals for line in cells):
        yield (
            "In brackets: 95 % confidence intervals of runs, from a bootstrap over images (over sequences if pairs "
            "belong to sequences)."
        )
    elif any(line.run is not None for line in cells):
        yield "No confidence intervals: too few images or sequences."
    if len({line.frames for line in cells}) > 1:
        yield "Rows are sorted within each group."


def _column(metric: str, corruption: str, family: str) -> BoardColumn:
    return BoardColumn(
        short_label(corruption),
        key=(metric, corruption),
        explanation=f"{METRIC_LABELS[metric]} under {long_label(corruption)} ({FAMILY_LABELS[family]})",
        views=(family,),
        metric=metric,
        unit="px",
    )


def _mean_column(metric: str, over: str, label: str, views: tuple[str, ...]) -> BoardColumn:
    explanation = f"{METRIC_LABELS[metric]}, mean over {'all corruptions' if over == AVERAGE else 'the class'}"
    return BoardColumn(label, key=(metric, over), explanation=explanation, views=views, metric=metric, unit="px")

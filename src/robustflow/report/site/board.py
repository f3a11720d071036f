"""The leaderboard as data: its columns, and the lines below each heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...analysis.labels import (
    FAMILY_LABELS,
    METRIC_LABELS,
    SETTING_EXPLANATIONS,
    SETTING_LABELS,
    benchmark_label,
    long_label,
    setting_words,
    short_label,
)
from ...analysis.published.tables import PAPER
from ...analysis.results import AVERAGE, CLEAN
from ...corruptions.names import MEMBERS
from ...text import plain
from .entries import COVERAGE, START, LeaderboardEntry, NumberKey, default_order

OVERVIEW = "overview"
CLASSES = "classes"
BOARD_METRICS = ("epe", "cre", "rcre")


@dataclass(frozen=True)
class BoardColumn:
    """A column: it is shown in some `views` (`OVERVIEW`, `CLASSES`, a family), and only with its metric if it has
    one."""

    key: NumberKey
    label: str
    title: str
    views: tuple[str, ...]
    metric: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Group:
    """Lines measured on the same frames, the only ones that are compared."""

    title: str
    published: bool
    entries: tuple[LeaderboardEntry, ...]


@dataclass(frozen=True)
class Board:
    """The leaderboard of a benchmark.

    Attributes:
        benchmark: its name; `label` for display.
        views, metrics, settings: the choices as (value, label), for a setting also its meaning.
        start: index of the column by which the lines are sorted initially.
    """

    benchmark: str
    label: str
    columns: tuple[BoardColumn, ...]
    groups: tuple[Group, ...]
    views: tuple[tuple[str, str], ...]
    metrics: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str, str], ...]
    start: int

    @property
    def count(self) -> int:
        """Number of lines."""
        return sum(len(group.entries) for group in self.groups)


_OVERVIEW = (
    BoardColumn(("epe", CLEAN), "Clean EPE", "End-point error on the clean frames", (OVERVIEW,), unit="px"),
    BoardColumn(("epe", AVERAGE), "EPE", "End-point error, mean over all corruptions", (OVERVIEW,), unit="px"),
    BoardColumn(("cre", AVERAGE), "CRE", "Corruption Robustness Error: EPE - clean EPE", (OVERVIEW,), unit="px"),
    BoardColumn(("crer", AVERAGE), "CREr", "CRE / clean EPE", (OVERVIEW,)),
    BoardColumn(("rcre", AVERAGE), "RCRE", "How far the flow moves under corruption", (OVERVIEW,), unit="px"),
    BoardColumn(
        COVERAGE, "Coverage", "Share of the pixels that the model predicted; errors are over these", (OVERVIEW,)
    ),
    BoardColumn(("parameters", ""), "Param.", "Parameters, millions", (OVERVIEW,), unit="M"),
    BoardColumn(("flops", ""), "FLOPs", "Floating-point operations of one prediction, 10⁹", (OVERVIEW,), unit="G"),
    BoardColumn(("rank", ""), "Avg. rank", "Rank of the mean of the FLOPs and CREr ranks (Tab. 3)", (OVERVIEW,)),
)


def boards_of(
    entries: Sequence[LeaderboardEntry], group_titles: dict[str, str], most_models_first: bool = False
) -> list[Board]:
    """A board per benchmark, in the order of the entries.

    Args:
        entries: from `entries_of`.
        group_titles: heading of each sample set.
        most_models_first: whether the board of the benchmark with most models comes first, whatever the entries' order.
    """
    benchmarks = list(dict.fromkeys(entry.benchmark for entry in entries))
    if most_models_first:
        models = {name: len({entry.model for entry in entries if entry.benchmark == name}) for name in benchmarks}
        benchmarks.sort(key=lambda name: -models[name])
    return [_board(name, [e for e in entries if e.benchmark == name], group_titles) for name in benchmarks]


def _board(benchmark: str, entries: list[LeaderboardEntry], group_titles: dict[str, str]) -> Board:
    keys = {key for entry in entries for key in entry.texts}
    columns = [column for column in _OVERVIEW if column.key in keys]
    metrics = [metric for metric in BOARD_METRICS if any((metric, family) in keys for family in MEMBERS)]
    families = [family for family in MEMBERS if any((metric, family) in keys for metric in metrics)]
    for metric in metrics:
        if (metric, AVERAGE) in keys:
            columns.append(_mean_column(metric, (metric, AVERAGE), f"AVG {METRIC_LABELS[metric]}", (CLASSES,)))
        for family in families:
            columns.append(_mean_column(metric, (metric, family), FAMILY_LABELS[family], (CLASSES, family)))
            columns += [_column(metric, name, family) for name in MEMBERS[family] if (metric, name) in keys]
    start = next((i for key in START for i, column in enumerate(columns) if column.key == key), 0)
    views = [(OVERVIEW, "Overview"), *([(CLASSES, "Class means")] if families else [])]
    settings = dict.fromkeys(entry.setting for entry in entries)
    return Board(
        benchmark=benchmark,
        label=benchmark_label(benchmark),
        columns=tuple(columns),
        groups=_groups(entries, group_titles),
        views=(*views, *((family, FAMILY_LABELS[family]) for family in families)),
        metrics=tuple((metric, METRIC_LABELS[metric]) for metric in metrics),
        settings=tuple(
            (name, setting_words(name), SETTING_EXPLANATIONS.get(name, ""))
            for name in dict.fromkeys([*SETTING_LABELS, *settings])
            if name in settings
        ),
        start=start,
    )


def _groups(entries: list[LeaderboardEntry], titles: dict[str, str]) -> tuple[Group, ...]:
    groups = []
    for frames in dict.fromkeys(entry.sample_set for entry in entries):
        lines = sorted((entry for entry in entries if entry.sample_set == frames), key=default_order)
        groups.append(Group(titles.get(frames, plain(frames, 200)), frames == PAPER, tuple(lines)))
    return tuple(groups)


def _column(metric: str, corruption: str, family: str) -> BoardColumn:
    title = f"{METRIC_LABELS[metric]} under {long_label(corruption)} ({FAMILY_LABELS[family]})"
    return BoardColumn((metric, corruption), short_label(corruption), title, (family,), metric, "px")


def _mean_column(metric: str, key: NumberKey, label: str, views: tuple[str, ...]) -> BoardColumn:
    title = f"{METRIC_LABELS[metric]}, mean over {'all corruptions' if key[1] == AVERAGE else 'the class'}"
    return BoardColumn(key, label, title, views, metric, "px")

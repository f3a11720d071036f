"""The leaderboard as data: its columns, and the lines below each heading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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
from .entries import COVERAGE, PLACE, START, LeaderboardEntry, NumberKey, default_order

OVERVIEW = "overview"
COMPACT = "compact"
"""The columns that fit a phone beside the names."""

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
        remarks: what its marks mean, of those that are in it.
    """

    benchmark: str
    label: str
    columns: tuple[BoardColumn, ...]
    groups: tuple[Group, ...]
    views: tuple[tuple[str, str], ...]
    metrics: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str, str], ...]
    start: int
    remarks: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of lines."""
        return sum(len(group.entries) for group in self.groups)


_OVERVIEW = (
    BoardColumn(PLACE, "Rank", "Among the models measured here on the same frames, by EPE (else RCRE)", (OVERVIEW,)),
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
_COMPACT: tuple[NumberKey, ...] = (("epe", AVERAGE), ("cre", AVERAGE), ("rcre", AVERAGE))


def boards_of(entries: Sequence[LeaderboardEntry], group_titles: dict[str, str]) -> list[Board]:
    """A board per benchmark: first that with most runs, of those without the one with most models.

    Args:
        entries: from `entries_of`.
        group_titles: heading of each sample set.
    """
    of_benchmark: dict[str, list[LeaderboardEntry]] = {}
    for entry in entries:
        of_benchmark.setdefault(entry.line.benchmark, []).append(entry)

    def place(lines: list[LeaderboardEntry]) -> tuple[int, int]:
        return -sum(entry.line.run is not None for entry in lines), -len({entry.model for entry in lines})

    order = sorted(of_benchmark.items(), key=lambda item: place(item[1]))
    return [_board(name, lines, group_titles) for name, lines in order]


def _board(benchmark: str, entries: list[LeaderboardEntry], group_titles: dict[str, str]) -> Board:
    keys = {key for entry in entries for key in entry.texts}
    columns = [column for column in _OVERVIEW if column.key in keys]
    few = [column.key for column in columns if column.key in _COMPACT][:2]
    columns = [replace(column, views=(*column.views, COMPACT)) if column.key in few else column for column in columns]
    metrics = [metric for metric in BOARD_METRICS if any((metric, family) in keys for family in MEMBERS)]
    families = [family for family in MEMBERS if any((metric, family) in keys for metric in metrics)]
    for metric in metrics:
        if (metric, AVERAGE) in keys:
            columns.append(_mean_column(metric, (metric, AVERAGE), f"AVG {METRIC_LABELS[metric]}", (CLASSES,)))
        for family in families:
            columns.append(_mean_column(metric, (metric, family), FAMILY_LABELS[family], (CLASSES, family)))
            columns += [_column(metric, name, family) for name in MEMBERS[family] if (metric, name) in keys]
    start = next((i for key in START for i, column in enumerate(columns) if column.key == key), 0)
    views = [(OVERVIEW, "Overview")] + [(COMPACT, "Compact")] * (len(columns) > len(few))
    views += [(CLASSES, "Class means")] * bool(families)
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
        remarks=tuple(_remarks(entries)),
    )


def _remarks(entries: list[LeaderboardEntry]) -> Iterator[str]:
    if any(entry.best for entry in entries):
        yield (
            "Bold: the best of its column among models of one setting measured on the same frames, as the paper marks "
            "it; knowledge-driven methods are not marked."
        )
    if any(entry.derived for entry in entries):
        yield "In italics: CREr where the paper prints none, from the values beside it."
    if any(entry.intervals for entry in entries):
        yield (
            "In brackets: 95 % confidence intervals of runs, by a bootstrap over images (over sequences where pairs "
            "share one)."
        )
    elif any(entry.line.run is not None for entry in entries):
        yield "No confidence intervals: too few images, or sequences, for one."
    if len({entry.line.frames for entry in entries}) > 1:
        yield "Lines are sorted within their group."


def _groups(entries: list[LeaderboardEntry], titles: dict[str, str]) -> tuple[Group, ...]:
    groups = []
    for frames in dict.fromkeys(entry.line.frames for entry in entries):
        lines = sorted((entry for entry in entries if entry.line.frames == frames), key=default_order)
        groups.append(Group(titles.get(frames, plain(frames, 200)), frames == PAPER, tuple(lines)))
    return tuple(groups)


def _column(metric: str, corruption: str, family: str) -> BoardColumn:
    title = f"{METRIC_LABELS[metric]} under {long_label(corruption)} ({FAMILY_LABELS[family]})"
    return BoardColumn((metric, corruption), short_label(corruption), title, (family,), metric, "px")


def _mean_column(metric: str, key: NumberKey, label: str, views: tuple[str, ...]) -> BoardColumn:
    title = f"{METRIC_LABELS[metric]}, mean over {'all corruptions' if key[1] == AVERAGE else 'the class'}"
    return BoardColumn(key, label, title, views, metric, "px")

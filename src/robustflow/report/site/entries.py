"""Results as the lines of a leaderboard: one entry per model, setting, benchmark and sample set."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

from ...analysis.best import Compared, best_of_columns
from ...analysis.cost_ranks import cost_ranks, run_ranks
from ...analysis.imported import NOTE as IMPORTED
from ...analysis.model_result import ModelResult
from ...analysis.published.tables import PAPER, Cost
from ...analysis.ranking import competition_ranks
from ...analysis.results import AVERAGE, CLEAN
from ...benchmarks import benchmark_facts
from ...runs.family_means import family_means
from ...text import plain
from ..table import number_text

NumberKey = tuple[str, str]
"""(metric, corruption, "clean", "average", or a family); ("parameters", ""), ("flops", ""), ("rank", ""),
`PLACE` and `COVERAGE`."""

COVERAGE: NumberKey = ("coverage", "")
PLACE: NumberKey = ("place", "")

Interval = tuple[float, float]

START: tuple[NumberKey, ...] = (("epe", AVERAGE), ("rcre", AVERAGE), ("epe", CLEAN))
"""The initial sort key: the error under corruption, or how far the flow moves without ground truth. CRE alone would put
the knowledge-driven methods first, whose clean error leaves little room to get worse."""


@dataclass
class LeaderboardEntry:
    """A line of the leaderboard.

    Attributes:
        line: what it shows.
        page: the id of the model's page.
        intervals: 95 % confidence intervals, if any.
        texts: the printed numbers.
        numbers: the same as numbers.
        derived: keys of numbers that the paper does not print and that are computed from its others.
        best: keys whose printed number is the smallest among the models of its setting and sample set.
    """

    line: ModelResult
    page: str
    intervals: Mapping[NumberKey, Interval]
    texts: dict[NumberKey, str] = field(default_factory=dict)
    numbers: dict[NumberKey, float] = field(default_factory=dict)
    derived: set[NumberKey] = field(default_factory=set)
    best: set[NumberKey] = field(default_factory=set)

    @property
    def model(self) -> str:
        """The name as one printable line."""
        return plain(self.line.name)

    @property
    def setting(self) -> str:
        """The setting as one printable line."""
        return plain(self.line.setting, 40)

    @property
    def note(self) -> str:
        """How it differs from the paper's measurement, as one printable line; "" if not at all."""
        return plain(self.line.note, 300)

    def set(self, key: NumberKey, value: float | None, decimals: int | None = None) -> None:
        """Store a number as printed; None is skipped."""
        if value is not None:
            self.numbers[key], self.texts[key] = value, number_text(value, decimals)


def entries_of(results: Sequence[ModelResult], costs: Mapping[str, Cost]) -> list[LeaderboardEntry]:
    """Entries of results, in their order, with the means over classes of corruptions that the paper does not print.

    Args:
        results: of any source.
        costs: the paper's, by model: its CREr is shown as printed.
    """
    slugs = Slugs()
    ranks = cost_ranks(costs) if costs else {}
    own_ranks = run_ranks([line for line in results if line.frames != PAPER])
    entries = []
    for line in results:
        entry = LeaderboardEntry(line, slugs.of(line.key, line.name), line.intervals)
        entries.append(entry)
        for key, value in line.values.items():
            entry.set(key, value.number, value.decimals)
        for metric in ("epe", "cre", "rcre"):
            values = {name: value for (of, name), value in entry.numbers.items() if of == metric}
            for family, mean in family_means(values).items():
                entry.set((metric, family), mean)
        entry.set(("crer", AVERAGE), line.crer)
        if line.frames == PAPER and line.crer is not None:
            entry.derived.add(("crer", AVERAGE))
        if line.frames == PAPER and benchmark_facts(line.benchmark).has_flow and line.name in costs:
            _add_published(entry, costs[line.name], ranks)
        elif line.cost is not None:
            entry.set(("parameters", ""), line.cost.parameters_m)
            entry.set(("flops", ""), line.cost.flops_g, 1)
            entry.set(("rank", ""), own_ranks[line].average if line in own_ranks else None, 0)
        entry.set(COVERAGE, line.coverage)
    _mark_best(entries)
    _rank_measured(entries)
    return entries


def _add_published(entry: LeaderboardEntry, cost: Cost, ranks: Mapping[str, Mapping[str, int]]) -> None:
    entry.set(("parameters", ""), cost.parameters_m)
    entry.set(("flops", ""), cost.flops_g, 1)
    setting = entry.setting.lower()
    if setting in ("ood", "id"):
        printed = getattr(cost, f"crer_{setting}")
        if printed is not None:
            entry.set(("crer", AVERAGE), printed)
            entry.derived.discard(("crer", AVERAGE))
        entry.set(("rank", ""), ranks[f"average_{setting}"].get(entry.line.name), 0)


_UNMARKED = {("parameters", ""), ("flops", ""), COVERAGE}


def _mark_best(entries: list[LeaderboardEntry]) -> None:
    """As in the paper, knowledge-driven methods have no marks, and neither do numbers that the paper does not print.
    Nor do imported lines: that they were measured on the same frames cannot be verified."""
    lines = []
    for entry in entries:
        never = entry.setting == "knowledge" or entry.note == IMPORTED
        unmarked = entry.texts.keys() if never else entry.derived | _UNMARKED
        texts = {key: text for key, text in entry.texts.items() if key not in unmarked}
        group = (entry.line.benchmark, entry.line.frames, entry.setting)
        lines.append(Compared(group, texts, bool(entry.line.excluded)))
    for entry, best in zip(entries, best_of_columns(lines), strict=True):
        entry.best |= best


def _rank_measured(entries: list[LeaderboardEntry]) -> None:
    """The place of each sound run among those on the same frames, whatever their setting, by the first of `START` that
    all of them have; equal printed values share it."""
    groups: dict[tuple[str, str], list[LeaderboardEntry]] = {}
    for entry in entries:
        if entry.line.run is not None and not entry.line.excluded:
            groups.setdefault((entry.line.benchmark, entry.line.frames), []).append(entry)
    for group in groups.values():
        key = next((key for key in START if all(key in entry.texts for entry in group)), None)
        if key is not None and len(group) > 1:
            places = competition_ranks({entry.page: float(entry.texts[key]) for entry in group})
            for entry in group:
                entry.set(PLACE, places[entry.page], 0)


def default_order(entry: LeaderboardEntry) -> tuple[bool, bool, float, str]:
    """Sort by `START`, then by name; excluded models, which have no rank, come last."""
    value = next((entry.numbers[key] for key in START if key in entry.numbers), None)
    return bool(entry.line.excluded), value is None, value or 0.0, entry.model


_LONGEST_ID = 40


class Slugs:
    """Gives every model's page its id of letters, digits and hyphens, safe in an address and an attribute.

    >>> slugs = Slugs()
    >>> slugs.of(1, "SAMFlow-H"), slugs.of(2, "samflow h"), slugs.of(1, "SAMFlow-H"), slugs.of(3, "<>")
    ('samflow-h', 'samflow-h-2', 'samflow-h', 'model')
    """

    def __init__(self) -> None:
        self._of: dict[Hashable, str] = {}

    def of(self, thing: Hashable, name: str) -> str:
        """The id of a thing called `name`."""
        if thing not in self._of:
            words = name.replace("+", " plus ").lower()
            stem = re.sub(r"[^a-z0-9]+", "-", words)[:_LONGEST_ID].strip("-") or "model"
            known, slug, count = set(self._of.values()), stem, 1
            while slug in known:
                count += 1
                slug = f"{stem}-{count}"
            self._of[thing] = slug
        return self._of[thing]

"""Results as the lines of a leaderboard: one entry per model, setting, benchmark and sample set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import polars as pl

from ...analysis.best import Compared, best_of_columns
from ...analysis.cost_ranks import cost_ranks, measured_crer, run_ranks
from ...analysis.imported import NOTE as IMPORTED
from ...analysis.published.tables import PAPER, Cost
from ...analysis.ranking import competition_ranks
from ...analysis.results import AVERAGE, CLEAN
from ...benchmarks import benchmark_facts
from ...runs.costs import RunCost
from ...runs.family_means import family_means
from ...text import plain
from ..table import number_text
from .slugs import Slugs

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
        benchmark, sample_set, setting: what it was measured on, and how that relates to the model's training.
        model: the name, as one printable line, as `setting` and `note` are.
        name: the name as the results have it.
        note: how it differs from the paper's measurement; "" if not at all.
        page: the id of the model's page.
        texts: the printed numbers.
        numbers: the same as numbers.
        derived: keys of numbers that the paper does not print and that are computed from its others.
        best: keys whose printed number is the smallest among the models of its setting and sample set.
        intervals: 95 % confidence intervals, if any.
        doubt: why its model is not ranked; "" for a sound one.
        measured: whether it is a run's.
    """

    benchmark: str
    sample_set: str
    setting: str
    model: str
    name: str
    note: str
    page: str
    texts: dict[NumberKey, str] = field(default_factory=dict)
    numbers: dict[NumberKey, float] = field(default_factory=dict)
    derived: set[NumberKey] = field(default_factory=set)
    best: set[NumberKey] = field(default_factory=set)
    intervals: dict[NumberKey, Interval] = field(default_factory=dict)
    doubt: str = ""
    measured: bool = False

    def set(self, key: NumberKey, value: float | None, decimals: int | None = None) -> None:
        """Store a number as printed; None is skipped."""
        if value is not None:
            self.numbers[key], self.texts[key] = value, number_text(value, decimals)


def entries_of(
    results: pl.DataFrame,
    costs: Mapping[str, Cost],
    intervals: Mapping[tuple[str, str], Mapping[NumberKey, Interval]] | None = None,
    run_costs: Mapping[tuple[str, str], RunCost] | None = None,
    first: Sequence[tuple[str, str, str, str, str]] = (),
    doubted: Mapping[tuple[str, str], str] | None = None,
    coverage: Mapping[tuple[str, str], float] | None = None,
) -> list[LeaderboardEntry]:
    """Entries of results, in their order, with the means over classes of corruptions that the paper does not print.

    Args:
        results: columns of `results.RESULT_SCHEMA`.
        costs: the paper's, by model: its CREr is shown as printed.
        intervals: by (sample set, name) of a run.
        run_costs: of runs, by (sample set, name).
        first: (benchmark, sample set, setting, model, note) of runs, which come first, whatever the results.
        doubted: by (sample set, name) of a run, why its model is not called the best of any column.
        coverage: for runs that left out pixels, the share that is included in the errors.
    """
    entries: dict[tuple[str, str, str, str], LeaderboardEntry] = {}
    slugs = Slugs()

    def entry_of(benchmark: str, frames: str, setting: str, model: str, note: str) -> LeaderboardEntry:
        key = (benchmark, frames, setting, model)
        if key not in entries:
            texts = (plain(setting, 40), plain(model), model, plain(note, 300))
            entries[key] = LeaderboardEntry(benchmark, frames, *texts, page=slugs.of((frames, model), model))
        return entries[key]

    for head in first:
        entry_of(*head)
    measured = {(frames, model) for _, frames, _, model, _ in first}
    for row in results.iter_rows(named=True):
        entry = entry_of(*(row[name] for name in ("benchmark", "sample_set", "setting", "model", "note")))
        entry.set((row["metric"], row["corruption"]), row["value"], row["decimals"])
    crer = {
        (benchmark, *key): value
        for benchmark in dict.fromkeys(results["benchmark"])
        for key, (value, _) in measured_crer(results.filter(benchmark=benchmark)).items()
    }
    ranks = cost_ranks(costs) if costs else {}
    own_ranks = run_ranks(measured_crer(results.filter(pl.col("sample_set") != PAPER)), run_costs or {}, doubted or {})
    for key, entry in entries.items():
        for metric in ("epe", "cre", "rcre"):
            values = {name: value for (of, name), value in entry.numbers.items() if of == metric}
            for family, mean in family_means(values).items():
                entry.set((metric, family), mean)
        run = (entry.sample_set, entry.name)
        entry.set(("crer", AVERAGE), crer.get(key))
        if entry.sample_set == PAPER and ("crer", AVERAGE) in entry.numbers:
            entry.derived.add(("crer", AVERAGE))
        if entry.sample_set == PAPER and benchmark_facts(entry.benchmark).has_flow and entry.name in costs:
            _add_published(entry, costs[entry.name], ranks)
        elif run_costs and run in run_costs:
            entry.set(("parameters", ""), run_costs[run].parameters_m)
            entry.set(("flops", ""), run_costs[run].flops_g, 1)
            own = own_ranks.get(key[1:])
            entry.set(("rank", ""), own.average if own else None, 0)
        entry.doubt = (doubted or {}).get(run, "")
        entry.measured = run in measured
        entry.set(COVERAGE, (coverage or {}).get(run))
        entry.intervals = dict((intervals or {}).get(run, {}))
    _mark_best(list(entries.values()), doubted or {})
    _rank_measured(list(entries.values()))
    return list(entries.values())


def _add_published(entry: LeaderboardEntry, cost: Cost, ranks: Mapping[str, Mapping[str, int]]) -> None:
    entry.set(("parameters", ""), cost.parameters_m)
    entry.set(("flops", ""), cost.flops_g, 1)
    setting = entry.setting.lower()
    if setting in ("ood", "id"):
        printed = getattr(cost, f"crer_{setting}")
        if printed is not None:
            entry.set(("crer", AVERAGE), printed)
            entry.derived.discard(("crer", AVERAGE))
        entry.set(("rank", ""), ranks[f"average_{setting}"].get(entry.name), 0)


_UNMARKED = {("parameters", ""), ("flops", ""), COVERAGE}


def _mark_best(entries: list[LeaderboardEntry], doubted: Mapping[tuple[str, str], str]) -> None:
    """As in the paper, knowledge-driven methods have no marks, and neither do numbers that the paper does not print.
    Nor do imported lines: that they were measured on the same frames cannot be verified."""
    lines = []
    for entry in entries:
        never = entry.setting == "knowledge" or entry.note == IMPORTED
        unmarked = entry.texts.keys() if never else entry.derived | _UNMARKED
        texts = {key: text for key, text in entry.texts.items() if key not in unmarked}
        group = (entry.benchmark, entry.sample_set, entry.setting)
        lines.append(Compared(group, texts, (entry.sample_set, entry.name) in doubted))
    for entry, best in zip(entries, best_of_columns(lines), strict=True):
        entry.best |= best


def _rank_measured(entries: list[LeaderboardEntry]) -> None:
    """The place of each sound run among those on the same frames, whatever their setting, by the first of `START` that
    all of them have; equal printed values share it."""
    groups: dict[tuple[str, str], list[LeaderboardEntry]] = {}
    for entry in entries:
        if entry.measured and not entry.doubt:
            groups.setdefault((entry.benchmark, entry.sample_set), []).append(entry)
    for group in groups.values():
        key = next((key for key in START if all(key in entry.texts for entry in group)), None)
        if key is not None and len(group) > 1:
            places = competition_ranks({entry.page: float(entry.texts[key]) for entry in group})
            for entry in group:
                entry.set(PLACE, places[entry.page], 0)


def default_order(entry: LeaderboardEntry) -> tuple[bool, bool, float, str]:
    """By `START`, then by name; doubted models, which have no rank, last."""
    value = next((entry.numbers[key] for key in START if key in entry.numbers), None)
    return bool(entry.doubt), value is None, value or 0.0, entry.model

"""Results as the lines of a leaderboard: one entry per model, setting, benchmark and sample set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import polars as pl

from ...analysis.cost_ranks import cost_ranks, measured_crer, run_ranks
from ...analysis.published.tables import PAPER, Cost
from ...analysis.results import AVERAGE, CLEAN
from ...benchmarks import benchmark_facts
from ...corruptions.registry import FAMILIES
from ...runs.costs import RunCost
from ...text import plain
from ..table import number_text
from .slugs import Slugs

Key = tuple[str, str]
"""(metric, corruption, "clean", "average", or a family); ("parameters", ""), ("flops", "") and ("rank", "")."""

Interval = tuple[float, float]

START: tuple[Key, ...] = (("epe", AVERAGE), ("rcre", AVERAGE), ("epe", CLEAN))
"""What lines are sorted by at first: the error under corruption, or how far the flow moves without ground truth. CRE
alone would put the knowledge-driven methods first, whose clean error leaves little room to get worse."""


@dataclass
class Entry:
    """A line of the leaderboard.

    Attributes:
        benchmark, sample_set, setting: what it was measured on, and what its model has seen of it.
        model: the name, as one printable line, as `setting` and `note` are.
        name: the name as the results have it.
        note: how it differs from the paper's measurement, "" for not at all.
        page: the id of the model's page.
        texts: the printed numbers.
        numbers: the same as numbers.
        derived: keys of numbers that the paper has not printed and that are made from others of its.
        best: keys whose printed number is the smallest among the models of its setting and sample set.
        intervals: 95 % confidence intervals, where there are any.
    """

    benchmark: str
    sample_set: str
    setting: str
    model: str
    name: str
    note: str
    page: str
    texts: dict[Key, str] = field(default_factory=dict)
    numbers: dict[Key, float] = field(default_factory=dict)
    derived: set[Key] = field(default_factory=set)
    best: set[Key] = field(default_factory=set)
    intervals: dict[Key, Interval] = field(default_factory=dict)

    def set(self, key: Key, value: float | None, decimals: int | None = None) -> None:
        """Keep a number as it is printed; None is not kept."""
        if value is not None:
            self.numbers[key], self.texts[key] = value, number_text(value, decimals)


def entries_of(
    results: pl.DataFrame,
    costs: Mapping[str, Cost],
    intervals: Mapping[tuple[str, str], Mapping[Key, Interval]] | None = None,
    run_costs: Mapping[tuple[str, str], RunCost] | None = None,
    first: Sequence[tuple[str, str, str, str, str]] = (),
) -> list[Entry]:
    """Entries of results, in their order, with the means over classes of corruptions that the paper does not print.

    Args:
        results: columns of `results.RESULT_SCHEMA`.
        costs: the paper's, by model: its CREr is shown as printed.
        intervals: by (sample set, name) of a run.
        run_costs: of runs, by (sample set, name).
        first: (benchmark, sample set, setting, model, note) of entries that are there whatever the results say, before
            the others.
    """
    entries: dict[tuple[str, str, str, str], Entry] = {}
    slugs = Slugs()

    def entry_of(benchmark: str, frames: str, setting: str, model: str, note: str) -> Entry:
        key = (benchmark, frames, setting, model)
        if key not in entries:
            texts = (plain(setting, 40), plain(model), model, plain(note, 300))
            entries[key] = Entry(benchmark, frames, *texts, page=slugs.of((frames, model), model))
        return entries[key]

    for head in first:
        entry_of(*head)
    for row in results.iter_rows(named=True):
        entry = entry_of(*(row[name] for name in ("benchmark", "sample_set", "setting", "model", "note")))
        entry.set((row["metric"], row["corruption"]), row["value"], row["decimals"])
    crer = {
        (benchmark, *key): value
        for benchmark in dict.fromkeys(results["benchmark"])
        for key, (value, _) in measured_crer(results.filter(benchmark=benchmark)).items()
    }
    ranks = cost_ranks(costs) if costs else {}
    own_ranks = run_ranks(measured_crer(results.filter(pl.col("sample_set") != PAPER)), run_costs or {})
    for key, entry in entries.items():
        _add_families(entry)
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
        entry.intervals = dict((intervals or {}).get(run, {}))
    _mark_best(list(entries.values()))
    return list(entries.values())


def _add_families(entry: Entry) -> None:
    for metric in ("epe", "cre", "rcre"):
        for family, names in FAMILIES.items():
            values = [entry.numbers[metric, name] for name in names if (metric, name) in entry.numbers]
            if values:
                entry.set((metric, family), sum(values) / len(values))


def _add_published(entry: Entry, cost: Cost, ranks: Mapping[str, Mapping[str, int]]) -> None:
    entry.set(("parameters", ""), cost.parameters_m)
    entry.set(("flops", ""), cost.flops_g, 1)
    setting = entry.setting.lower()
    if setting in ("ood", "id"):
        printed = getattr(cost, f"crer_{setting}")
        if printed is not None:
            entry.set(("crer", AVERAGE), printed)
            entry.derived.discard(("crer", AVERAGE))
        entry.set(("rank", ""), ranks[f"average_{setting}"].get(entry.name), 0)


def _mark_best(entries: list[Entry]) -> None:
    """As in the paper: equal printed numbers share the mark; knowledge-driven methods, a model alone and numbers that
    the paper does not print have none."""
    groups: dict[tuple[str, str, str], list[Entry]] = {}
    for entry in entries:
        groups.setdefault((entry.benchmark, entry.sample_set, entry.setting), []).append(entry)
    for (_, _, setting), group in groups.items():
        if setting == "knowledge" or len(group) == 1:
            continue
        for key in {key for entry in group for key in entry.texts} - {("parameters", ""), ("flops", "")}:
            compared = [entry for entry in group if key in entry.texts and key not in entry.derived]
            least = min((float(entry.texts[key]) for entry in compared), default=None)
            for entry in compared:
                if float(entry.texts[key]) == least:
                    entry.best.add(key)


def default_order(entry: Entry) -> tuple[bool, float, str]:
    """By `START`, then by name."""
    value = next((entry.numbers[key] for key in START if key in entry.numbers), None)
    return value is None, value or 0.0, entry.model

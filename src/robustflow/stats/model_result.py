"""`ModelResult`: one line of a results table, from a run, the paper, or a results file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from ..core.errors import DataError
from ..core.text import plain
from ..core.types import Frozen
from ..run.costs import RunCost, read_cost
from .ranking import average_ranks, competition_ranks
from .results import AVERAGE, CLEAN, NEVER_RANKED, family_crer
from .uncertainty.intervals import IntervalEnds, interval_ends

if TYPE_CHECKING:
    from ..run.run import Run

ValueKey = tuple[str, str]
"""(metric, condition), where the condition is a corruption, "clean" or "average"."""

_UNROUNDED = 1e-9
"""The relative error assumed for a number that was not rounded for printing."""


@dataclass(frozen=True)
class Value:
    """A number, its printed number of decimals (None if not rounded), whether the source sets it in bold (None if the
    source sets nothing in bold), and the source."""

    number: float
    decimals: int | None = None
    marked: bool | None = None
    source: str = ""

    @property
    def text(self) -> str:
        """The number formatted with as many decimals as printed, or with two if it was not rounded."""
        return f"{self.number:.{2 if self.decimals is None else self.decimals}f}"

    @property
    def half(self) -> float:
        """Half a unit of the last printed digit, which is the largest possible rounding error."""
        return _UNROUNDED * max(1.0, abs(self.number)) if self.decimals is None else 0.5 * 10.0**-self.decimals


class PrintedCost(Frozen):
    """Size, computing cost and relative robustness of a model in the paper (Tab. 3), with the printed ranks."""

    row: int
    model: str
    parameters_m: float
    flops_g: float
    flops_rank: int
    crer_ood: float | None
    crer_rank_ood: int | None
    crer_id: float | None
    crer_rank_id: int | None
    average_rank_ood: int | None
    average_rank_id: int | None
    source: str


@dataclass(frozen=True, eq=False)
class ModelResult:
    """One line of a results table. Values derived from a run's rows are computed on first use and cached."""

    benchmark: str
    frames: str
    setting: str
    name: str
    note: str
    values: Mapping[ValueKey, Value]
    run: Run | None = None
    beside_published: bool = False
    detailed: bool = True
    published: bool = False
    printed_cost: PrintedCost | None = None
    stated_coverage: float | None = None
    exclusion: Callable[[], str] = field(default=str, repr=False)

    @property
    def source(self) -> Literal["measured", "verified record", "published", "claimed"]:
        """Where the values come from. Only values with rows can be checked; a results file merely claims its values."""
        if self.run is not None:
            return "verified record" if self.run.record else "measured"
        return "published" if self.published else "claimed"

    def may_be_best(self, metric: str) -> bool:
        """Return whether the lowest value of a metric may be marked: of runs, only the EPE, because a flow that is too
        short has a lower CRE, CREr and RCRE than the sound flow; of the paper, all of them."""
        if self.setting == "knowledge":
            return False
        return self.published or (self.run is not None and metric == "epe")

    @property
    def key(self) -> tuple[str, str]:
        """(frames, name), which is unique among lines from runs."""
        return self.frames, self.name

    @cached_property
    def excluded(self) -> str:
        """The reason why the model is not ranked; "" for a ranked model."""
        return self.exclusion() or NEVER_RANKED.get(self.setting, "")

    @cached_property
    def cost(self) -> RunCost | None:
        """The computational cost of the run's model."""
        return read_cost(self.run) if self.run else None

    @property
    def coverage(self) -> float | None:
        """The fraction of pixels included in the errors; None for all pixels. Pixels without a predicted flow and
        planned rows that are missing are not included."""
        if self.run is None:
            return self.stated_coverage
        predicted = self.run.mean("coverage") if self.run.averages.has_gaps else None
        if not self.run.measured.missing:
            return predicted
        missing = sum(len(cells.samples) for cells in self.run.measured.missing)
        return (1.0 if predicted is None else predicted) * (1 - missing / len(self.run.planned()))

    @cached_property
    def cre(self) -> Mapping[str, float]:
        """The CRE by corruption, and "average": as measured, over the pixels that have a flow on both the clean and the
        corrupted frames. Where only a rounded CRE or none is given, it is EPE - clean EPE, because the published CRE
        does not match the published EPE (see `robustflow reproduce audit`)."""
        epe = self.numbers("epe")
        clean = epe.pop(CLEAN, None)
        computed = {} if clean is None else {of: value - clean for of, value in epe.items()}
        printed = {of: value for (metric, of), value in self.values.items() if metric == "cre"}
        return computed | {of: value.number for of, value in printed.items() if value.decimals is None}

    @cached_property
    def family_crer(self) -> Mapping[str, float]:
        """The CREr of each family, from `cre`; empty without a clean EPE."""
        return family_crer(self.cre, self.number("epe", CLEAN))

    @cached_property
    def crer(self) -> float | None:
        """The average CREr, either given or computed from the average CRE and the clean EPE."""
        given, clean, cre = self.number("crer", AVERAGE), self.number("epe", CLEAN), self.cre.get(AVERAGE)
        return cre / clean if given is None and cre is not None and clean else given

    @cached_property
    def intervals(self) -> Mapping[ValueKey, IntervalEnds]:
        """The 95 % intervals of a run's means, including corruption families (see `interval_ends`); empty without a
        run."""
        return interval_ends(self.run, self.detailed, self.beside_published) if self.run else {}

    def number(self, metric: str, condition: str) -> float | None:
        """Return the number of a metric under a condition; None if there is no value."""
        value = self.values.get((metric, condition))
        return None if value is None else value.number

    def numbers(self, metric: str) -> dict[str, float]:
        """Return the numbers of one metric by condition."""
        return {of: value.number for (kind, of), value in self.values.items() if kind == metric}


def merged(lines: Iterable[ModelResult], where: str = "") -> list[ModelResult]:
    """Merge lines with the same benchmark, sample set, setting and name, in order of first appearance. The note of the
    first line and the smallest stated coverage are kept. `where` names the source in error messages.
    """
    parts: dict[tuple[str, str, str, str], list[ModelResult]] = {}
    for line in lines:
        parts.setdefault((line.benchmark, line.frames, line.setting, line.name), []).append(line)
    return [one[0] if len(one) == 1 else _joined_lines(one, where) for one in parts.values()]


def _joined_lines(lines: Sequence[ModelResult], where: str) -> ModelResult:
    values: dict[ValueKey, Value] = {}
    for line in lines:
        for metric, condition in values.keys() & line.values.keys():
            whose = f"'{plain(line.name)}' ({plain(line.setting)}, sample set '{plain(line.frames)}')"
            message = f"{metric} of {whose} on {condition} appears twice; give each value only once"
            raise DataError(where or plain(line.name), message)
        values |= line.values
    coverage = min((line.stated_coverage for line in lines if line.stated_coverage is not None), default=None)
    return replace(lines[0], values=values, stated_coverage=coverage)


def ranked(results: Iterable[ModelResult]) -> list[ModelResult]:
    """Select the lines whose model is ranked, for statements about models in general."""
    return [line for line in results if not line.excluded]


def not_ranked(results: Iterable[ModelResult]) -> list[str]:
    """Return "<name>, because <reason>" for each model that is not ranked."""
    return [f"{plain(line.name)}, because {line.excluded}" for line in results if line.excluded]


def by_frames(results: Iterable[ModelResult]) -> dict[str, Sequence[ModelResult]]:
    """Group the lines by sample set, within which they can be compared."""
    groups: dict[str, list[ModelResult]] = {}
    for line in results:
        groups.setdefault(line.frames, []).append(line)
    return dict(groups)


def printed_costs(results: Iterable[ModelResult]) -> dict[str, PrintedCost]:
    """Return the paper's costs for the models in the results, by model name, in the order of Tab. 3."""
    costs = {line.name: line.printed_cost for line in results if line.printed_cost is not None}
    return dict(sorted(costs.items(), key=lambda item: item[1].row))


def printed_cost_ranks(results: Iterable[ModelResult]) -> dict[str, dict[str, int]]:
    """Rank the models with a printed cost by "flops", "crer_ood", "crer_id", "average_ood" and "average_id"."""
    costs = printed_costs(results)
    ranks = {"flops": competition_ranks({name: cost.flops_g for name, cost in costs.items()})}
    for setting in ("ood", "id"):
        known = {name: getattr(cost, f"crer_{setting}") for name, cost in costs.items()}
        ranks[f"crer_{setting}"] = competition_ranks(
            {name: value for name, value in known.items() if value is not None}
        )
        ranks[f"average_{setting}"] = average_ranks(ranks[f"crer_{setting}"], ranks["flops"])
    return ranks

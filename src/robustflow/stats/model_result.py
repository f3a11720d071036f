"""`ModelResult`: the numbers of one model on one sample set in one setting, a line of the results frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import polars as pl

from ..core.text import plain
from ..corruptions.registry import MEMBERS
from ..metrics.cube import PAPER
from ..metrics.error_maps import crer
from ..metrics.measures import LEADING
from ..metrics.regions import REGIONS
from ..run.comparable import run_names, sample_set
from .frame import LINE, once, results_frame
from .intervals import IntervalEnds
from .results import AVERAGE, CLEAN, RESULT_METRICS, family_crer, family_means

if TYPE_CHECKING:
    from ..run.run import Run

ValueKey = tuple[str, str]
"""(measure, condition), where the condition is a corruption, a family, "clean" or "average"; "" for a model's cost."""

PARAMETERS: ValueKey = ("parameters", "")
FLOPS: ValueKey = ("flops", "")
CRER: ValueKey = ("crer", AVERAGE)
RANKS = {name: (f"{name}_rank", "") for name in ("flops", "crer", "average")}
"""The ranks that the paper's Tab. 3 prints."""

_UNROUNDED = 1e-9
"""The relative error assumed for a number that was not rounded for printing."""
_WITHOUT_TRUTH = ("flow_length", "photometric", "photometric_still")
"""The measures of a run that a line shows without ground truth."""


@dataclass(frozen=True)
class Value:
    """A number of the results frame: its printed decimals, whether it is set in bold, what it is from, and the ends of
    its interval. A `derived` one is computed from the others of its line."""

    number: float
    decimals: int | None = None
    marked: bool | None = None
    origin: str = ""
    ends: IntervalEnds | None = None
    derived: bool = False

    @property
    def text(self) -> str:
        """The number formatted with as many decimals as printed, or with two if it was not rounded."""
        return f"{self.number:.{2 if self.decimals is None else self.decimals}f}"

    @property
    def half(self) -> float:
        """Half a unit of the last printed digit, which is the largest possible rounding error."""
        return _UNROUNDED * max(1.0, abs(self.number)) if self.decimals is None else 0.5 * 10.0**-self.decimals


@dataclass(frozen=True, eq=False)
class ModelResult:
    """A line of the results frame."""

    benchmark: str
    frames: str
    setting: str
    name: str
    note: str
    values: Mapping[ValueKey, Value]
    source: str = "claimed"
    coverage: float | None = None
    excluded: str = ""
    run: Run | None = None
    beside_published: bool = False
    families: Mapping[ValueKey, Value] = field(default_factory=dict)

    def may_be_best(self, metric: str) -> bool:
        """Return whether the lowest value of a metric may be marked: of runs, only the EPE, because a flow that is too
        short has a lower CRE, CREr and RCRE than the sound flow; of the paper, all of them."""
        if self.setting == "knowledge":
            return False
        return self.source == "published" or (self.run is not None and metric == LEADING)

    @property
    def key(self) -> tuple[str, str]:
        """(frames, name), which is unique among lines from runs."""
        return self.frames, self.name

    @cached_property
    def cre(self) -> Mapping[str, float]:
        """The CRE by corruption, and "average": as measured, over the pixels that have a flow on both the clean and the
        corrupted frames. Where only a rounded CRE or none is given, it is EPE - clean EPE, because the published CRE
        does not match the published EPE (see `robustflow reproduce audit`)."""
        return changes(self.values)

    @cached_property
    def intervals(self) -> Mapping[ValueKey, IntervalEnds]:
        """The 95 % intervals of a run's means, including corruption families."""
        every = {**self.values, **self.families}
        return {key: value.ends for key, value in every.items() if value.ends is not None}

    def number(self, metric: str, condition: str) -> float | None:
        """Return the number of a metric under a condition; None if there is no value."""
        value = self.values.get((metric, condition))
        return None if value is None else value.number

    def numbers(self, metric: str) -> dict[str, float]:
        """Return the numbers of one metric by condition."""
        return {of: value.number for (kind, of), value in self.values.items() if kind == metric}

    @property
    def family_crer(self) -> Mapping[str, float]:
        """The CREr of each family, from `cre`; empty without a clean EPE."""
        return {family: value.number for (metric, family), value in self.families.items() if metric == "crer"}


def changes(values: Mapping[ValueKey, Value]) -> dict[str, float]:
    """Return the CRE by condition (`ModelResult.cre`)."""
    clean = values.get(("epe", CLEAN))
    of_metric = {metric: {of: v for (m, of), v in values.items() if m == metric} for metric in ("epe", "cre")}
    computed = {of: v.number - clean.number for of, v in of_metric["epe"].items() if of != CLEAN} if clean else {}
    return computed | {of: value.number for of, value in of_metric["cre"].items() if value.decimals is None}


def lines_of(
    frame: pl.DataFrame, runs: Mapping[tuple[str, str], Run] | None = None, beside_published: bool = False
) -> list[ModelResult]:
    """Return the lines of a results frame in order of first appearance, with what follows from their numbers: the means
    over families of corruptions and the CREr. `runs` are known by sample set and name."""
    lines = []
    for head, part in once(frame).group_by(LINE, maintain_order=True):
        benchmark, frames, setting, name = map(str, head)
        rows = part.to_dicts()
        values = {
            (row["measure"], row["condition"]): Value(
                row["value"],
                row["decimals"],
                row["marked"],
                row["origin"],
                None if row["low"] is None else (row["low"], row["high"]),
            )
            for row in rows
        }
        run, share = (runs or {}).get((frames, name)), min((c for c in part["coverage"] if c is not None), default=None)
        facts = rows[0]["source"], share, rows[0]["excluded"], run, beside_published and run is not None
        values |= {key: value for key, value in _derived(values).items() if key not in values}
        families = {key: values.pop(key) for key in [*values] if key[1] in MEMBERS}
        lines.append(ModelResult(benchmark, frames, setting, name, rows[0]["note"], values, *facts, families))
    return lines


def _derived(values: Mapping[ValueKey, Value]) -> dict[ValueKey, Value]:
    """Compute what a line does not give: the means over families, and the CREr from the CRE and the clean EPE."""
    made: dict[ValueKey, float] = {}
    for metric in ("epe", "cre", "rcre"):
        of_metric = {of: value.number for (kind, of), value in values.items() if kind == metric}
        made |= {(metric, family): mean for family, mean in family_means(of_metric).items()}
    cre, clean = changes(values), values.get(("epe", CLEAN))
    if clean is not None:
        made |= {("crer", family): ratio for family, ratio in family_crer(cre, clean.number).items()}
        if (of_average := crer(cre.get(AVERAGE), clean.number)) is not None:
            made[CRER] = of_average
    return {key: Value(number, derived=True) for key, number in made.items()}


def run_frame(
    runs: Sequence[Run],
    beside_published: bool = False,
    *,
    notes: Sequence[str] | None = None,
    detailed: bool = True,
    intervals: bool = False,
) -> pl.DataFrame:
    """Return what lines show of runs (see `results_frame`): the EPE, CRE, RCRE and CREr over severities, of a run
    without ground truth how its flow explains the clean frames, and the cost of its model."""
    options: Any = {"intervals": intervals, "detailed": detailed, "notes": notes}
    frame = results_frame(runs, ["means", "facts"], beside_published=beside_published, **options)
    frame = frame.filter(pl.col("severity").is_null())
    of_clean = pl.col("condition") == CLEAN
    error = of_clean & (pl.col("measure") == "epe")
    means = pl.col("measure").is_in(RESULT_METRICS) & ~pl.col("condition").is_in([CLEAN, PAPER, *REGIONS])
    facts = pl.col("condition") == ""
    blind = pl.col("measure").is_in(_WITHOUT_TRUTH) & (of_clean | (pl.col("condition") == AVERAGE))
    shown = frame.filter(error | means | facts | (blind & error.any().over(LINE).not_()))
    return shown.with_columns(decimals=pl.when(pl.col("measure") == FLOPS[0]).then(pl.lit(1, pl.Int64)))


def run_results(runs: Sequence[Run], beside_published: bool = False, *, intervals: bool = False) -> list[ModelResult]:
    """Return the lines of runs, see `run_frame`."""
    frame = run_frame(runs, beside_published, intervals=intervals)
    return lines_of(frame, by_line(runs), beside_published)


def by_line(runs: Sequence[Run]) -> dict[tuple[str, str], Run]:
    """Return runs by the sample set and the name of their line."""
    return dict(zip(zip(map(sample_set, runs), run_names(runs), strict=True), runs, strict=True))


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

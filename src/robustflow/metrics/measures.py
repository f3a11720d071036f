"""Every measure, declared once.

A measure has one of three forms: an `Average` over images of `factor * total / count`, computed from the columns of a
row; an `Increase`, the difference of two averages over the same images; or a `Ratio` of one of these to an average on
the clean frames. `cube` evaluates them. Means, intervals, tests, checks, tables, figures and exports follow from these
tables: to add a measure, declare it here, and compute its column in `rows`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import polars as pl

from .error_maps import LARGEST_ERROR
from .regions import REGIONS
from .rows import CLEAN, COVERAGES

Verdict = Literal["leads", "compares", "explains"]
"""What may follow from a measure: `leads`, the best value may be marked; `compares`, a test may say which of two models
is better; `explains`, the same, but a flow that is worse in every other respect can be the better one."""

SIGNED = (-math.inf, math.inf)
PERCENT = (0.0, 100.0)


def exact_mean(values: Sequence[float]) -> float:
    """Return the mean, from the exactly rounded sum, so that the order of the values does not matter."""
    return math.fsum(values) / len(values)


def middle(values: Sequence[float]) -> float:
    """Return the median, the mean of the two middle values of an even number."""
    in_order, half = sorted(values), len(values) // 2
    return in_order[half] if len(values) % 2 else (in_order[half - 1] + in_order[half]) / 2


@dataclass(frozen=True, eq=False)
class Declared:
    """What every measure declares.

    Attributes:
        label: name in tables and figures.
        unit: unit for tables; empty for ratios.
        better: -1 if lower values are better, 1 if higher ones, 0 if neither.
        bounds: the possible values; the ends of intervals stay within.
        verdict: what may follow from it.
        on_clean: whether it says something about the clean frames, where changes are 0 by definition.
        explanation: one line of help.
    """

    label: str
    unit: str = "px"
    better: int = -1
    bounds: tuple[float, float] = (0.0, math.inf)
    verdict: Verdict = "compares"
    explanation: str = ""
    on_clean: bool = True


@dataclass(frozen=True, eq=False, kw_only=True)
class Average(Declared):
    """The mean over images of `factor * total / count`.

    Attributes:
        total: a sum, or another value of a row.
        count: what the sum is divided by; a row in which it is null or 0 is left out.
        factor: 100 for percentages.
        paired: name of a count that must also be positive on the clean frames; the clean frames have no value then.
        over: how images are averaged.
    """

    total: pl.Expr
    count: pl.Expr
    factor: float = 1.0
    paired: str = ""
    over: Callable[[Sequence[float]], float] = exact_mean

    @property
    def parts(self) -> tuple[Average, ...]:
        """The averages that the measure is computed from."""
        return (self,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Increase(Declared):
    """One average minus another, over the images that have both."""

    after: Average
    before: Average

    @property
    def parts(self) -> tuple[Average, ...]:
        """The averages that the measure is computed from."""
        return self.after, self.before


@dataclass(frozen=True, eq=False, kw_only=True)
class Ratio(Declared):
    """A measure divided by an average on the clean frames."""

    above: Average | Increase
    below: Average

    @property
    def parts(self) -> tuple[Average, ...]:
        """The averages that the measure is computed from."""
        return *self.above.parts, self.below


Measure = Average | Increase | Ratio


def _percent(label: str, total: pl.Expr, count: pl.Expr, explanation: str = "", better: int = -1) -> Average:
    facts: Any = {"unit": "%", "bounds": PERCENT, "better": better, "explanation": explanation}
    return Average(label, total=total, count=count, factor=100.0, **facts)


def _of_errors(count: str, region: str = "") -> dict[str, Measure]:
    """Return the measures that exist for all pixels and for each region."""
    pixels, before = pl.col(count), pl.col(f"clean_epe_sum{region}")
    epe = Average("EPE", verdict="leads", explanation="End-point error", total=pl.col(f"epe_sum{region}"), count=pixels)
    cre = Increase(
        "CRE",
        bounds=SIGNED,
        verdict="explains",
        explanation="EPE - clean EPE",
        after=epe,
        before=Average("EPE before", total=before, count=pixels, paired=count),
    )
    explained: Any = {"bounds": SIGNED, "verdict": "explains", "explanation": "mean CRE / mean clean EPE"}
    return {
        "epe": epe,
        "cre": cre,
        "crer": Ratio("CREr", "", **explained, above=cre, below=epe),
        "rcre": Average("RCRE", explanation=_MOVED, on_clean=False, total=pl.col(f"rcre_sum{region}"), count=pixels),
        "fl": _percent("Fl", pl.col(f"fl_count{region}"), pixels, "Error > 3 px and > 5 %"),
    }


_MOVED = "Change in the flow under corruption"
_valid, _all, _every = pl.col("n_valid"), pl.col("n_all"), pl.col("height") * pl.col("width")
_with_truth = pl.coalesce("n_valid", "n_all")
"""Pixels over which errors are computed: with ground truth if the sample has any."""
_blind = _valid.is_null()
_one = pl.lit(1)
_errors = _of_errors("n_valid")
_grey: Any = {"unit": "grey levels", "count": pl.col("n_photometric")}


def _known(column: str, count: pl.Expr = _one) -> pl.Expr:
    """The count of rows in which a column has a value."""
    return pl.when(pl.col(column).is_not_null()).then(count)


def _column(label: str, column: str, unit: str = "px", **facts: Any) -> Average:
    """A value that a row contains as it is."""
    return Average(label, unit, total=pl.col(column), **{"count": _known(column)} | facts)


_moved = pl.when(_blind).then("rcre_all_sum").otherwise("rcre_sum")

MEASURES: dict[str, Measure] = {
    **{name: _errors[name] for name in ("epe", "cre", "crer")},
    "rcre": Average("RCRE", verdict="explains", explanation=_MOVED, on_clean=False, total=_moved, count=_with_truth),
    "rcre_all": Average(
        "RCRE, all pixels",
        verdict="explains",
        explanation="RCRE over all pixels",
        on_clean=False,
        total=pl.col("rcre_all_sum"),
        count=_all,
    ),
    "fl": _errors["fl"],
    "px1": _percent("> 1 px", pl.col("px1_count"), _valid, "Error > 1 px"),
    "px3": _percent("> 3 px", pl.col("px3_count"), _valid, "Error > 3 px"),
    "px5": _percent("> 5 px", pl.col("px5_count"), _valid, "Error > 5 px"),
    "wauc": _percent("WAUC", pl.col("wauc_sum"), _valid, "Weighted area under the inlier curve", better=1),
    "photometric": Average(
        "photometric error", explanation="Photometric error", total=pl.col("photometric_sum"), **_grey
    ),
    "coverage": Average(
        "coverage",
        "",
        better=1,
        bounds=(0.0, 1.0),
        total=_with_truth,
        count=pl.when(_blind).then(_every).otherwise("n_truth"),
    ),
    "spread": Average("spread", on_clean=False, total=pl.col("spread_sum"), count=_known("spread_sum", _all)),
}
"""The measures of every condition."""

METRICS = tuple(MEASURES)
"""The names of the measures of every condition, in the order of tables."""

(LEADING,) = (name for name, measure in MEASURES.items() if measure.verdict == "leads")
"""The measure of which the best value may be marked."""

CLEAN_MEASURES: dict[str, Average] = {
    "flow_length": Average(
        "clean flow length",
        better=0,
        explanation="Mean length of the flow",
        total=pl.col("pred_magnitude_sum"),
        count=_all,
    ),
    "photometric_still": Average(
        "photometric error of zero flow",
        explanation="Photometric error of a flow that is zero",
        total=pl.col("photometric_still_sum"),
        **_grey,
    ),
    "zero_flow_epe": Average("EPE of zero flow", better=0, total=pl.col("magnitude_sum"), count=_valid),
}
"""Measures of the clean frames alone."""

REGION_MEASURES: dict[str, dict[str, Measure]] = {
    region: _of_errors(f"n_{region}", f"_{region}")
    | {"share": _percent("share", pl.col(f"n_{region}"), _known(f"n_{region}", _valid))}
    for region in REGIONS
}
"""The measures of each region of the image; `share` is the percentage of the valid pixels inside."""

CONFIDENCE: dict[str, Measure] = {
    "ause": _column("AUSE", "ause"),
    "ause_normalised": _column("AUSE, normalised", "ause", "", count=_known("ause", pl.col("epe_sum") / _valid)),
    "error_at_100": _column("error at 100 %", "epe_sum", count=_known("ause", _valid)),
    **{
        f"{at}_at_{share}": _column(f"{at} at {share} %", f"{at}_at_{share}")
        for at in ("error", "oracle")
        for share in COVERAGES
    },
    "confidence_spearman": _column("Spearman", "confidence_spearman", "", bounds=(-1.0, 1.0)),
    "rejected": _percent("rejected", pl.col("rejected_count"), _known("rejected_count", _all)),
}

_after, _before = pl.col("epe_sum") / _valid, pl.col("clean_epe_sum") / _valid
_ratio = (_after / _before).log()
_positive = pl.when((pl.col("epe_sum") > 0) & (pl.col("clean_epe_sum") > 0)).then(pl.when(_valid > 0).then(1))
_explains: Any = {"bounds": SIGNED, "verdict": "explains", "paired": "n_valid"}


def _clean(column: str) -> pl.Expr:
    """The value in the sample's clean row."""
    return pl.when(pl.col("corruption") == CLEAN).then(column).max().over("sample")


UNCOUPLED: dict[str, Measure] = {
    "log_ratio": Average("log ratio", "", **_explains, total=_ratio, count=_positive),
    "median_log_ratio": Average("median log ratio", "", **_explains, total=_ratio, count=_positive, over=middle),
    "median_cre": Average(
        "median CRE",
        **_explains,
        total=pl.when(pl.max_horizontal(_after, _before) <= LARGEST_ERROR).then(_after - _before).otherwise(math.inf),
        count=pl.when(_valid > 0).then(1),
        over=middle,
    ),
    "fl_increase": Average(
        "Fl increase",
        "points",
        **_explains,
        total=pl.when(_valid == _clean("n_valid")).then(pl.col("fl_count") - _clean("fl_count")).otherwise(math.nan),
        count=_valid,
        factor=100.0,
    ),
}
"""Measures of robustness that depend less on accuracy than CRE. The increase of Fl is known only where every image has
the same pixels as on the clean frames."""

ATTACK: dict[str, Measure] = {
    "attack_median": _column("median", "attack_median", better=0),
    "attack_capped": _column("capped", "attack_capped_sum", count=_known("attack_capped_sum", _valid), better=0),
    "attack_way_gone": _column("target progress", "attack_way_gone", "%", factor=100.0, better=0, bounds=SIGNED),
    "attack_late_gain": _column("last quarter", "attack_late_gain", better=0),
    "attack_start_spread": _column("start spread", "attack_start_spread", better=0),
    "attack_linf": _column("L-inf", "attack_linf", "grey levels", better=0),
    "attack_rms": _column("RMS", "attack_rms", "grey levels", better=0),
    "attack_evaluations": _column("flows", "attack_evaluations", "", better=0),
}
"""Measures of the rows of attacks."""

EVERY: dict[str, Measure] = {**MEASURES, **CLEAN_MEASURES, **CONFIDENCE, **UNCOUPLED, **ATTACK}
"""Every measure of whole images by name."""
LABELS: dict[str, str] = {name: measure.label for name, measure in EVERY.items()}
"""The name of every measure in tables and figures."""
UNITS: dict[str, str] = {name: measure.unit for name, measure in EVERY.items()}
"""The unit of every measure; empty for ratios."""

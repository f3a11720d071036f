"""Every measure, declared once.

A measure of an image is `factor * total / count`, computed from its row; `means` averages it over images, severities
and corruptions. The means, checks, tables, pages and exports follow from this table: to add a measure, declare it here,
and compute its column in `rows`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import polars as pl

from .regions import REGIONS
from .rows import CLEAN, COVERAGES


def exact_mean(values: Sequence[float]) -> float:
    """Return the mean, from the exactly rounded sum, so that the order of the values does not matter."""
    return math.fsum(values) / len(values)


def middle(values: Sequence[float]) -> float:
    """Return the median, the mean of the two middle values of an even number."""
    in_order, half = sorted(values), len(values) // 2
    return in_order[half] if len(values) % 2 else (in_order[half - 1] + in_order[half]) / 2


@dataclass(frozen=True, eq=False)
class Measure:
    """`factor * total / count` of each row, for rows with a positive count.

    Attributes:
        label: name in tables and figures.
        total: a sum, or another value of a row.
        count: what the sum is divided by; a row in which it is null or 0 is left out.
        unit: unit for tables; empty for ratios.
        factor: 100 for percentages.
        minus: the value on the clean frames; its mean over the same images is subtracted.
        paired: name of a count that must also be positive on the clean frames; the clean frames have no value then.
        over: how images are averaged.
        better: -1 if lower values are better, 1 if higher ones, 0 if neither.
        explanation: one line of help.
    """

    label: str
    total: pl.Expr
    count: pl.Expr
    unit: str = "px"
    factor: float = 1.0
    minus: pl.Expr | None = None
    paired: str = ""
    over: Callable[[Sequence[float]], float] = exact_mean
    better: int = -1
    explanation: str = ""


def _of_errors(count: str, region: str = "") -> dict[str, Measure]:
    """Return the measures that exist for all pixels and for each region."""
    pixels, total = pl.col(count), pl.col(f"epe_sum{region}")
    before = pl.col(f"clean_epe_sum{region}")
    return {
        "epe": Measure("EPE", total, pixels, explanation="End-point error"),
        "cre": Measure("CRE", total, pixels, minus=before, paired=count, explanation="EPE - clean EPE"),
        "rcre": Measure("RCRE", pl.col(f"rcre_sum{region}"), pixels, explanation="Change in the flow under corruption"),
        "fl": Measure("Fl", pl.col(f"fl_count{region}"), pixels, "%", 100.0, explanation="Error > 3 px and > 5 %"),
    }


_valid, _all, _every = pl.col("n_valid"), pl.col("n_all"), pl.col("height") * pl.col("width")
_with_truth = pl.coalesce("n_valid", "n_all")
"""Pixels over which errors are computed: with ground truth if the sample has any."""
_blind = _valid.is_null()
_one = pl.lit(1)
_errors = _of_errors("n_valid")


def _known(column: str, count: pl.Expr = _one) -> pl.Expr:
    """The count of rows in which a column has a value."""
    return pl.when(pl.col(column).is_not_null()).then(count)


MEASURES: dict[str, Measure] = {
    "epe": _errors["epe"],
    "cre": _errors["cre"],
    "rcre": Measure(
        "RCRE",
        pl.when(_blind).then("rcre_all_sum").otherwise("rcre_sum"),
        _with_truth,
        explanation="Change in the flow under corruption",
    ),
    "rcre_all": Measure("RCRE, all pixels", pl.col("rcre_all_sum"), _all, explanation="RCRE over all pixels"),
    "fl": _errors["fl"],
    "px1": Measure("> 1 px", pl.col("px1_count"), _valid, "%", 100.0, explanation="Error > 1 px"),
    "px3": Measure("> 3 px", pl.col("px3_count"), _valid, "%", 100.0, explanation="Error > 3 px"),
    "px5": Measure("> 5 px", pl.col("px5_count"), _valid, "%", 100.0, explanation="Error > 5 px"),
    "wauc": Measure(
        "WAUC", pl.col("wauc_sum"), _valid, "%", 100.0, better=1, explanation="Weighted area under the inlier curve"
    ),
    "photometric": Measure(
        "photometric error", pl.col("photometric_sum"), pl.col("n_photometric"), "grey levels", explanation=""
    ),
    "coverage": Measure(
        "coverage", _with_truth, pl.when(_blind).then(_every).otherwise("n_truth"), "", better=1, explanation=""
    ),
    "spread": Measure("spread", pl.col("spread_sum"), _known("spread_sum", _all), explanation=""),
}
"""The measures of every condition. CREr is not an average of images: it is the mean CRE divided by the mean clean EPE
(`means`)."""

METRICS = tuple(name for measured in MEASURES for name in ((measured, "crer") if measured == "cre" else (measured,)))
"""The measures with CREr, in the order of tables."""

CLEAN_MEASURES: dict[str, Measure] = {
    "flow_length": Measure("clean flow length", pl.col("pred_magnitude_sum"), _all, better=0),
    "photometric_still": Measure(
        "photometric error of zero flow", pl.col("photometric_still_sum"), pl.col("n_photometric"), "grey levels"
    ),
    "zero_flow_epe": Measure("EPE of zero flow", pl.col("magnitude_sum"), _valid, better=0),
}
"""Measures of the clean frames alone."""

BEFORE = Measure("EPE before", pl.col("clean_epe_sum"), _valid, explanation="Clean EPE over the pixels of EPE")
"""The part of CRE that is subtracted."""

REGION_MEASURES = {region: _of_errors(f"n_{region}", f"_{region}") for region in REGIONS}

CONFIDENCE: dict[str, Measure] = {
    "ause": Measure("AUSE", pl.col("ause"), _known("ause")),
    "ause_normalised": Measure("AUSE, normalised", pl.col("ause"), _known("ause", pl.col("epe_sum") / _valid), ""),
    "error_at_100": Measure("error at 100 %", pl.col("epe_sum"), _known("ause", _valid)),
    **{
        f"{at}_at_{share}": Measure(f"{at} at {share} %", pl.col(f"{at}_at_{share}"), _known(f"{at}_at_{share}"))
        for at in ("error", "oracle")
        for share in COVERAGES
    },
    "confidence_spearman": Measure("Spearman", pl.col("confidence_spearman"), _known("confidence_spearman"), ""),
    "rejected": Measure("rejected", pl.col("rejected_count"), _known("rejected_count", _all), "%", 100.0),
}

_ratio = (pl.col("epe_sum") / _valid / (pl.col("clean_epe_sum") / _valid)).log()
_positive = pl.when((pl.col("epe_sum") > 0) & (pl.col("clean_epe_sum") > 0)).then(pl.when(_valid > 0).then(1))


def _clean(column: str) -> pl.Expr:
    """The value in the sample's clean row."""
    return pl.when(pl.col("corruption") == CLEAN).then(column).max().over("sample")


UNCOUPLED: dict[str, Measure] = {
    "log_ratio": Measure("log ratio", _ratio, _positive, "", paired="n_valid"),
    "median_log_ratio": Measure("median log ratio", _ratio, _positive, "", paired="n_valid", over=middle),
    "median_cre": Measure(
        "median CRE",
        pl.col("epe_sum") / _valid - pl.col("clean_epe_sum") / _valid,
        pl.when(_valid > 0).then(1),
        paired="n_valid",
        over=middle,
    ),
    "fl_increase": Measure(
        "Fl increase",
        pl.when(_valid == _clean("n_valid")).then(pl.col("fl_count") - _clean("fl_count")).otherwise(math.nan),
        _valid,
        "points",
        100.0,
        paired="n_valid",
    ),
}
"""Measures of robustness that depend less on accuracy than CRE. The increase of Fl is known only where every image has
the same pixels as on the clean frames."""


def _attack(label: str, column: str, factor: float = 1.0, unit: str = "px") -> Measure:
    return Measure(label, pl.col(column), _known(column), unit, factor, better=0)


ATTACK: dict[str, Measure] = {
    "attack_median": _attack("median", "attack_median"),
    "attack_capped": Measure("capped", pl.col("attack_capped_sum"), _known("attack_capped_sum", _valid), better=0),
    "attack_way_gone": _attack("target progress", "attack_way_gone", 100.0, "%"),
    "attack_late_gain": _attack("last quarter", "attack_late_gain"),
    "attack_start_spread": _attack("start spread", "attack_start_spread"),
    "attack_linf": _attack("L-inf", "attack_linf", unit="grey levels"),
    "attack_rms": _attack("RMS", "attack_rms", unit="grey levels"),
    "attack_evaluations": _attack("flows", "attack_evaluations", unit=""),
}
"""Measures of the rows of attacks."""

LABELS: dict[str, str] = {"crer": "CREr"}
"""The name of every measure in tables and figures."""
UNITS: dict[str, str] = {"crer": ""}
"""The unit of every measure; empty for ratios."""
for _measures in (MEASURES, CLEAN_MEASURES, CONFIDENCE, UNCOUPLED, ATTACK):
    LABELS |= {name: one.label for name, one in _measures.items()}
    UNITS |= {name: one.unit for name, one in _measures.items()}

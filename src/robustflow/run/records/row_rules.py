"""Rules that every row of a run must satisfy, according to the definitions in `robustflow.metrics.rows`. Check a
record's measurements: compare the summary with the rows, and find impossible rows.

The rules hold for any model on any frames, so a row that breaks a rule was not measured or was changed afterwards. Sums
of lengths are compared up to a relative rounding error of 1e-9.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import reduce
from itertools import chain
from operator import add, or_
from typing import TYPE_CHECKING

import polars as pl

from ...attacks.ball import GREY_LEVELS
from ...attacks.registry import norm_of
from ...attacks.result import WARNINGS
from ...core.arguments import SEVERITIES
from ...metrics.regions import MAGNITUDE_BOUNDS, REGIONS
from ...metrics.rows import CLEAN, COVERAGES, ROW_SCHEMA, SIGNED

if TYPE_CHECKING:
    from ..run import Run

_CLOSE_ROW_RULES = 1e-9
_OF_ATTACKS = tuple(name for name in ROW_SCHEMA if name.startswith("attack_"))
_MAY_FALL = (*SIGNED, "attack_way_gone")
_SUMS = tuple(name for name, kind in ROW_SCHEMA.items() if kind is pl.Float64 and name not in _MAY_FALL)
_COUNTS = tuple(name for name, kind in ROW_SCHEMA.items() if kind is pl.Int64)
_OUTLIERS = ("fl_count", "px1_count", "px3_count", "px5_count")
_TRUTH = ("n_valid", "epe_sum", "rcre_sum", "magnitude_sum", *_OUTLIERS, "wauc_sum")
_SPLITS = (("noc", "occ"), ("s0_10", "s10_40", "s40"), ("d0_10", "d10_60", "d60"))
_SHORT, _LONG = MAGNITUDE_BOUNDS
_BEFORE = "_clean"

_Expr = pl.Expr


def broken_rules(rows: pl.DataFrame, attacks: Collection[str] = ()) -> Iterator[tuple[str, pl.DataFrame]]:
    """Yield, for each rule, a description of the violation and the rows that violate the rule."""
    rows = rows.with_columns(_attack=pl.col("corruption").is_in(list(attacks)))
    clean = rows.filter(corruption=CLEAN).unique("sample")
    both = rows.join(clean.select("sample", pl.exclude("sample").name.suffix(_BEFORE)), on="sample", how="left")
    for reason, condition in RULES.items():
        yield reason, both.filter(condition.fill_null(False))


def broken_attack_rules(rows: pl.DataFrame) -> Iterator[tuple[str, pl.DataFrame]]:
    """Like `broken_rules`, but for the columns that only attack rows have."""
    attacks = rows.filter(pl.col("corruption") != CLEAN)
    cells = list(attacks.select("corruption", "severity").unique().iter_rows())
    linf, rms = (
        {
            (name, severity): GREY_LEVELS[norm][severity - 1]
            for name, severity in cells
            if norm_of(name) == norm and severity in SEVERITIES
        }
        for norm in ("linf", "rms")
    )
    known = {"", *WARNINGS}
    unknown = [text for text in attacks["attack_warnings"].drop_nulls().unique() if not {*text.split(",")} <= known]
    of_truth = pl.col("n_valid").is_not_null() & (pl.col("n_valid") > 0)
    rules = {
        "attack values are missing": pl.any_horizontal(
            pl.col("attack_linf", "attack_rms", "attack_evaluations").is_null()
        )
        | (of_truth & pl.any_horizontal(pl.col("attack_capped_sum", "attack_median").is_null())),
        "the attack exceeds its budget": _any([*_above("attack_linf", linf), *_above("attack_rms", rms)]),
        "the norms of the perturbation are inconsistent": _exceeds(pl.col("attack_rms"), pl.col("attack_linf"))
        | (pl.col("attack_linf") > 255),
        "its capped error exceeds its error": _exceeds(pl.col("attack_capped_sum"), pl.col("epe_sum")),
        "its flow moved beyond the target": pl.col("attack_way_gone") > 1 + _CLOSE_ROW_RULES,
        "it has an unknown warning": pl.col("attack_warnings").is_in(unknown),
    }
    for reason, condition in rules.items():
        yield reason, attacks.filter(condition.fill_null(False))


def _above(column: str, budgets: Mapping[tuple[str, int], float]) -> list[_Expr]:
    return [
        (pl.col("corruption") == name)
        & (pl.col("severity") == severity)
        & (pl.col(column) > budget * (1 + _CLOSE_ROW_RULES))
        for (name, severity), budget in budgets.items()
    ]


def _any(conditions: Iterator[_Expr] | list[_Expr]) -> _Expr:
    return reduce(or_, (condition.fill_null(False) for condition in conditions), pl.lit(False))


def _differ(first: _Expr, second: _Expr) -> _Expr:
    """Whether two sums over the same pixels differ by more than the order of summation can explain."""
    return (first - second).abs() > _CLOSE_ROW_RULES * (1 + first.abs() + second.abs())


def _exceeds(first: _Expr, second: _Expr) -> _Expr:
    return first > second + _CLOSE_ROW_RULES * (1 + first.abs() + second.abs())


def _jump(total: str, count: str, moved: str) -> _Expr:
    """Whether a sum of lengths differs from the clean row by more than the flow changed, over the same pixels."""
    same = pl.col(count) == pl.col(count + _BEFORE)
    before = pl.col(total + _BEFORE)
    scale = _CLOSE_ROW_RULES * (1 + pl.col(total) + before + pl.col(moved))
    return same & ((pl.col(total) - before).abs() > pl.col(moved) + scale)


def _missing_together(names: tuple[str, ...]) -> _Expr:
    return pl.any_horizontal(pl.col(name).is_null() != pl.col(names[0]).is_null() for name in names[1:])


def _misfit(parts: tuple[str, ...]) -> _Expr:
    """Whether the values of the regions in one split do not add up to those of all valid pixels."""
    exact = [
        reduce(add, (pl.col(f"{field}_{part}") for part in parts)) != pl.col(whole)
        for field, whole in (("n", "n_valid"), ("fl_count", "fl_count"))
    ]
    sums = [
        _differ(reduce(add, (pl.col(f"{field}_{part}") for part in parts)), pl.col(field))
        for field in ("epe_sum", "rcre_sum")
    ]
    return _any(exact + sums)


def _differs_within_sample(name: str, where: _Expr) -> _Expr:
    first = pl.col(name).filter(where).first().over("sample")
    return where & pl.col(name).ne_missing(first)


_pixels = pl.col("height") * pl.col("width")
_whole = pl.col("n_all") == _pixels
_all_of = ("n", "epe_sum", "rcre_sum", "fl_count")

RULES: dict[str, _Expr] = {
    "it has attack values but is not an attack": ~pl.col("_attack")
    & _any([pl.col(name).is_not_null() for name in _OF_ATTACKS]),
    "its clean error differs from that of the sample's clean row": _any(
        [
            (pl.col(f"n_{part}") == pl.col(f"n_{part}{_BEFORE}"))
            & (pl.col(f"clean_epe_sum{name}") != pl.col(f"epe_sum{name}{_BEFORE}"))
            for part, name in (("valid", ""), *((region, f"_{region}") for region in REGIONS))
        ]
    ),
    "the error changed by more than the flow itself over the same pixels": _any(
        [
            (pl.col(f"epe_sum{name}") - pl.col(f"clean_epe_sum{name}")).abs()
            > pl.col(f"rcre_sum{name}")
            + _CLOSE_ROW_RULES
            * (1 + pl.col(f"epe_sum{name}") + pl.col(f"clean_epe_sum{name}") + pl.col(f"rcre_sum{name}"))
            for name in ("", *(f"_{region}" for region in REGIONS))
        ]
    ),
    "its sums are negative or not finite": _any([~pl.col(c).is_finite() | (pl.col(c) < 0) for c in _SUMS]),
    "it has more outliers than pixels": _any(
        [(pl.col(c) > pl.col("n_valid")) | (pl.col(c) < 0) for c in _OUTLIERS]
        + [_exceeds(pl.col("wauc_sum"), pl.col("n_valid").cast(pl.Float64))]
        + [pl.col(f"fl_count_{region}") > pl.col(f"n_{region}") for region in REGIONS]
    ),
    "the error changed by more than the flow itself": _any(
        [_jump("epe_sum", "n_valid", "rcre_sum")]
        + [_jump(f"epe_sum_{region}", f"n_{region}", f"rcre_sum_{region}") for region in REGIONS]
    ),
    "the flow's length changed by more than the flow itself": _jump("pred_magnitude_sum", "n_all", "rcre_all_sum"),
    "it counts more pixels than the frame has": _any(
        [pl.col(c) < 0 for c in _COUNTS]
        + [pl.col("height") < 1, pl.col("width") < 1, pl.col("n_all") + pl.col("n_invalid") > _pixels]
        + [pl.col("n_valid") > pl.col("n_all"), pl.col("n_valid") > pl.col("n_truth"), pl.col("n_truth") > _pixels]
        + [_whole & (pl.col("n_valid") != pl.col("n_truth")), pl.col("n_photometric") + pl.col("n_invalid") > _pixels]
    ),
    "some of the values that are always measured together are missing": _any(
        [_missing_together(_TRUTH)]
        + [_missing_together(tuple(f"{field}_{region}" for field in _all_of)) for region in REGIONS]
        + [pl.col("n_valid").is_null() & pl.col(f"n_{region}").is_not_null() for region in REGIONS]
    ),
    "its errors do not match what its corruption leaves of the ground truth": pl.when(pl.col("truth") == "none")
    .then(pl.col("n_valid").is_not_null())
    .otherwise(pl.col("n_valid").is_null() & pl.col("n_valid_clean").is_not_null()),
    "the values of its regions do not add up to those of all pixels": _any([_misfit(parts) for parts in _SPLITS]),
    "its counts of 1, 3 and 5 px outliers are inconsistent": _any(
        [
            pl.col(few) > pl.col(many)
            for few, many in (("px5_count", "px3_count"), ("px3_count", "px1_count"), ("fl_count", "px3_count"))
        ]
    ),
    "its error is smaller than its outliers alone imply": _exceeds(
        pl.col("px1_count") + 2.0 * pl.col("px3_count") + 2.0 * pl.col("px5_count"), pl.col("epe_sum")
    ),
    "the length of its ground-truth flow does not match its regions": _any(
        [
            _exceeds(_SHORT * pl.col("n_s10_40") + _LONG * pl.col("n_s40"), pl.col("magnitude_sum")),
            (pl.col("n_s40") == 0)
            & _exceeds(pl.col("magnitude_sum"), _SHORT * pl.col("n_s0_10") + _LONG * pl.col("n_s10_40")),
        ]
    ),
    "its flow is too short for an error this small": _exceeds(
        pl.col("magnitude_sum"), pl.col("pred_magnitude_sum") + pl.col("epe_sum")
    ),
    "its confidence ranks errors better than the oracle": _any(
        [_exceeds(pl.col(f"oracle_at_{share}"), pl.col(f"error_at_{share}")) for share in COVERAGES]
        + [pl.col("rejected_count") > pl.col("n_all"), pl.col("confidence_spearman").abs() > 1]
    ),
    "the clean frames have a spread, although they involve no randomness": (pl.col("corruption") == CLEAN)
    & (pl.col("spread_sum") != 0),
    "the flow changed more on valid pixels than on all pixels": _exceeds(pl.col("rcre_sum"), pl.col("rcre_all_sum")),
    "its photometric error exceeds the range of grey levels": _any(
        [_exceeds(pl.col(f"photometric_{c}sum"), 255.0 * pl.col("n_photometric")) for c in ("", "still_")]
    ),
    "the flow on the clean frames differs from the clean flow": (pl.col("corruption") == CLEAN)
    & _any([pl.col("severity") != 0] + [pl.col(c) != 0 for c in _SUMS if c.startswith("rcre")]),
    "its size or group differs from that of the sample's other rows": _any(
        [_differs_within_sample(name, pl.lit(True)) for name in ("height", "width", "group")]
    ),
    "its ground truth differs from that of the sample's other rows": _any(
        [_differs_within_sample("n_truth", pl.col("n_truth").is_not_null())]
        + [
            _differs_within_sample(name, _whole & pl.col("n_valid").is_not_null())
            for name in ("n_valid", "magnitude_sum", *(f"n_{region}" for region in REGIONS))
        ]
    ),
}
"""Description of a violation -> condition that detects it. `<column>_clean` is the column in the sample's clean row."""


def row_problems(run: Run) -> tuple[list[str], int]:
    """Check that no row breaks a rule of `row_rules`; return the problems and the number of comparisons."""
    rows, broken_rows = run.rows, [broken_rules(run.rows)]
    if run.attacks:
        attacked = run.attack_rows
        rows = pl.concat([rows, attacked.filter(pl.col("corruption") != CLEAN)])
        broken_rows = [broken_rules(rows, run.attacks), broken_attack_rules(attacked)]
    problems = [
        f"rows: sample '{row['sample']}', {row['corruption']} severity {row['severity']}: {reason}"
        for reason, broken in chain.from_iterable(broken_rows)
        for row in broken.iter_rows(named=True)
    ]
    return problems, rows.height * len(RULES)

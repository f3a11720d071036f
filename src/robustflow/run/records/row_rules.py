"""Rules that every row of a run satisfies, whatever the model and the frames; a row that breaks one was not measured
or was changed afterwards.

Most rules follow from the declarations of the measures (`metrics.measures`): sums and counts are missing together, and
no mean exceeds the range of its unit. Sums of lengths are compared up to a relative rounding error of 1e-9.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import reduce
from operator import add

import polars as pl

from ...attacks.ball import GREY_LEVELS
from ...attacks.registry import norm_of
from ...attacks.result import FOLLOWED, WARNINGS
from ...core.arguments import SEVERITIES
from ...core.errors import DataError
from ...core.text import plain
from ...core.types import TRUTHS
from ...metrics.measures import ATTACK, CLEAN_MEASURES, CONFIDENCE, MEASURES, REGION_MEASURES, Average, Measure
from ...metrics.regions import MAGNITUDE_BOUNDS, REGIONS
from ...metrics.rows import CLEAN, COVERAGES, ROW_KEY, ROW_SCHEMA, SIGNED

_UNSAFE = r"[\p{Cc}\p{Cf}\p{Co}\p{Zl}\p{Zp}]"
"""Characters that control a terminal or the direction of text."""
_CLOSE = 1e-9
_LARGEST_SUM = 1e18
_LOWEST = {"attack_way_gone": -_LARGEST_SUM, **dict.fromkeys(SIGNED, -1.0)}
"""Lowest value of each column that may be negative."""
_BEFORE = "_clean"
"""Suffix of the columns of the sample's clean row."""
_LARGEST = {"%": 1.0, "grey levels": 255.0}
"""Largest value of one pixel, by unit."""
_SPLITS = (("noc", "occ"), ("s0_10", "s10_40", "s40"), ("d0_10", "d10_60", "d60"))
"""Regions that together are all pixels with ground truth."""
_CHANGES = ("rcre_sum", *(f"rcre_sum_{region}" for region in REGIONS))
_SAME = ("height", "width", "group")
_SHORT, _LONG = MAGNITUDE_BOUNDS

_Expr = pl.Expr
_whole_and_regions = {"": MEASURES, **{f"_{region}": measures for region, measures in REGION_MEASURES.items()}}


def _averages(*declared: Mapping[str, Measure]) -> list[Average]:
    return [part for measures in declared for measure in measures.values() for part in measure.parts]


_sums = _averages(*_whole_and_regions.values(), CLEAN_MEASURES)
_pixels = pl.col("height") * pl.col("width")
_predicted_all = pl.col("n_all") == _pixels
_is_clean = pl.col("corruption") == CLEAN
_attack = pl.col("_attack")


def _any(conditions: Iterable[_Expr]) -> _Expr:
    return pl.any_horizontal(condition.fill_null(False) for condition in conditions)


def _exceeds(first: _Expr, second: _Expr) -> _Expr:
    return first > second + _CLOSE * (1 + first.abs() + second.abs())


def _differ(first: _Expr, second: _Expr) -> _Expr:
    """Whether two sums over the same pixels differ by more than the order of summation can explain."""
    return (first - second).abs() > _CLOSE * (1 + first.abs() + second.abs())


def _changed_more(after: _Expr, before: _Expr, flow: _Expr) -> _Expr:
    """Whether a sum of lengths changed by more than the flow, over the same pixels."""
    return (after - before).abs() > flow + _CLOSE * (1 + after + before + flow)


def _total(column: str, parts: Iterable[str]) -> _Expr:
    return reduce(add, (pl.col(f"{column}_{part}") for part in parts))


def _beyond(measures: Iterable[Average]) -> _Expr:
    return _any(_exceeds(one.total, _LARGEST[one.unit] * one.count) for one in measures if one.unit in _LARGEST)


def _varies(column: str, where: _Expr) -> _Expr:
    """Whether a column differs between the rows of a sample that satisfy a condition."""
    return where & pl.col(column).ne_missing(pl.col(column).filter(where).first().over("sample"))


SINGLE_ROW_RULES: dict[str, _Expr] = {
    "a cell has one row": pl.struct(ROW_KEY).is_duplicated(),
    "no cell of these columns is empty": _any(
        pl.col(name).is_null()
        for name in (
            *("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width", "n_invalid"),
            *("n_all", "rcre_all_sum", "pred_magnitude_sum"),
            *("n_photometric", "photometric_sum", "photometric_still_sum"),
        )
    ),
    "names have 1 to 500 printable characters": _any(
        ~pl.col(name).str.len_chars().is_between(1, 500) | pl.col(name).str.contains(_UNSAFE)
        for name in ("sample", "group", "corruption")
    ),
    "digests have 32 hexadecimal digits, not all zero": _any(
        ~pl.col(name).str.contains("^[0-9a-f]{32}$") | pl.col(name).str.contains("^0+$")
        for name in ("frames_digest", "truth_digest")
    ),
    "the truth is known": ~pl.col("truth").is_in(TRUTHS),
    "a digest of the truth is that of measured pixels": pl.col("truth_digest").is_null() != pl.col("n_valid").is_null(),
    "numbers are finite, not too large, and positive where they have to be": _any(
        ~pl.col(name).is_between(*((0, 2**53) if kind is pl.Int64 else (_LOWEST.get(name, 0.0), _LARGEST_SUM)))
        for name, kind in ROW_SCHEMA.items()
        if kind is not pl.String
    ),
}
"""Name of each rule of a row by itself -> condition under which a row breaks it."""

RULES: dict[str, _Expr] = {
    "sums and their counts are measured together": _any(one.total.is_null() != one.count.is_null() for one in _sums),
    "no mean is beyond the range of its unit": _beyond([*_sums, *_averages(CONFIDENCE)]),
    "attack values are those of an attack": ~_attack
    & _any(pl.col(name).is_not_null() for name in ROW_SCHEMA if name.startswith("attack_")),
    "attack values are measured together": _attack
    & _any(
        [pl.col(name).is_null() for name in ("attack_linf", "attack_rms", "attack_evaluations")]
        + [(pl.col("n_valid") > 0) & pl.col(name).is_null() for name in ("attack_capped_sum", "attack_median")]
    ),
    "attacks are within their budgets": _any(
        [pl.col(f"attack_{norm}") > pl.col(f"_{norm}") * (1 + _CLOSE) for norm in ("linf", "rms")]
        + [_exceeds(pl.col("attack_rms"), pl.col("attack_linf")), _beyond(_averages(ATTACK))]
    ),
    "capped errors are at most the errors": _exceeds(pl.col("attack_capped_sum"), pl.col("epe_sum")),
    "warnings of attacks are known": ~pl.col("attack_warnings")
    .str.split(",")
    .list.eval(pl.element().is_in(["", *WARNINGS]))
    .list.all(),
    "gradients of attacks are known": ~pl.col("attack_gradient").is_in(FOLLOWED),
    "clean errors are those of the clean row": _any(
        (before.count == pl.col(before.paired + _BEFORE)) & (before.total != pl.col(f"epe_sum{part}{_BEFORE}"))
        for part, measures in _whole_and_regions.items()
        for before in measures["cre"].parts[1:]
    ),
    "an error changes by at most the change of the flow": _any(
        _changed_more(pl.col(f"epe_sum{part}"), pl.col(f"clean_epe_sum{part}"), pl.col(f"rcre_sum{part}"))
        for part in _whole_and_regions
    ),
    "a flow's length changes by at most the change of the flow": (pl.col("n_all") == pl.col(f"n_all{_BEFORE}"))
    & _changed_more(pl.col("pred_magnitude_sum"), pl.col(f"pred_magnitude_sum{_BEFORE}"), pl.col("rcre_all_sum")),
    "a frame has its pixels": _any(
        [
            *(pl.col("height") < 1, pl.col("width") < 1),
            pl.col("n_all") + pl.col("n_invalid") > _pixels,
            pl.col("n_valid") > pl.col("n_all"),
            pl.col("n_valid") > pl.col("n_truth"),
            pl.col("n_truth") > _pixels,
            _predicted_all & (pl.col("n_valid") != pl.col("n_truth")),
            pl.col("n_photometric") + pl.col("n_invalid") > _pixels,
        ]
    ),
    "regions are those of pixels with ground truth": pl.col("n_valid").is_null()
    & _any(pl.col(f"n_{region}").is_not_null() for region in REGIONS),
    "errors exist if the corruption leaves the ground truth": pl.when(pl.col("truth") == "none")
    .then(pl.col("n_valid").is_not_null())
    .otherwise(pl.col("n_valid").is_null() & pl.col(f"n_valid{_BEFORE}").is_not_null()),
    "regions add up to the whole": _any(
        [_total("n", parts) != pl.col("n_valid") for parts in _SPLITS]
        + [_total("fl_count", parts) != pl.col("fl_count") for parts in _SPLITS]
        + [_differ(_total(name, parts), pl.col(name)) for parts in _SPLITS for name in ("epe_sum", "rcre_sum")]
    ),
    "outliers of 5 px are outliers of 3 and 1 px": _any(
        pl.col(few) > pl.col(many)
        for few, many in (("px5_count", "px3_count"), ("px3_count", "px1_count"), ("fl_count", "px3_count"))
    ),
    "an error is at least that of its outliers": _exceeds(
        pl.col("px1_count") + 2.0 * pl.col("px3_count") + 2.0 * pl.col("px5_count"), pl.col("epe_sum")
    ),
    "the length of the ground truth fits its regions": _any(
        [
            _exceeds(_SHORT * pl.col("n_s10_40") + _LONG * pl.col("n_s40"), pl.col("magnitude_sum")),
            (pl.col("n_s40") == 0)
            & _exceeds(pl.col("magnitude_sum"), _SHORT * pl.col("n_s0_10") + _LONG * pl.col("n_s10_40")),
        ]
    ),
    "a flow is as long as the ground truth, up to its error": _exceeds(
        pl.col("magnitude_sum"), pl.col("pred_magnitude_sum") + pl.col("epe_sum")
    ),
    "no confidence ranks errors better than the oracle": _any(
        [_exceeds(pl.col(f"oracle_at_{share}"), pl.col(f"error_at_{share}")) for share in COVERAGES]
        + [pl.col("confidence_spearman").abs() > 1]
    ),
    "a flow changes on all pixels at least as much as on those with ground truth": _exceeds(
        pl.col("rcre_sum"), pl.col("rcre_all_sum")
    ),
    "clean frames have neither severity nor change nor spread": _is_clean
    & _any(pl.col(name) != 0 for name in ("severity", "spread_sum", "rcre_all_sum", *_CHANGES)),
    "rows of a sample have one size and group": _any(_varies(name, pl.lit(True)) for name in _SAME),
    "rows of a sample have one ground truth": _any(
        [_varies("n_truth", pl.col("n_truth").is_not_null())]
        + [
            _varies(name, _predicted_all & pl.col("n_valid").is_not_null())
            for name in ("n_valid", "magnitude_sum", *(f"n_{region}" for region in REGIONS))
        ]
    ),
}
"""Name of each rule -> condition under which a row breaks it. `<column>_clean` is the column in the sample's clean row;
`_attack` says whether the row is that of an attack, and `_linf` and `_rms` are its budgets in grey levels."""


def in_context(rows: pl.DataFrame, attacks: Collection[str] = ()) -> pl.DataFrame:
    """Return rows with the columns that `RULES` compares them with."""
    clean = rows.filter(corruption=CLEAN).unique("sample")
    both = rows.join(clean.select("sample", pl.exclude("sample").name.suffix(_BEFORE)), on="sample", how="left")
    budgets = {
        f"_{norm}": pl.when(pl.col("corruption").is_in([name for name in attacks if norm_of(name) == norm])).then(
            pl.col("severity").replace_strict(dict(zip(SEVERITIES, GREY_LEVELS[norm], strict=True)), default=None)
        )
        for norm in ("linf", "rms")
    }
    return both.with_columns(_attack=pl.col("corruption").is_in(list(attacks)), **budgets)


def broken_rules(rows: pl.DataFrame, attacks: Collection[str] = ()) -> Iterator[tuple[str, pl.DataFrame]]:
    """Yield each of `RULES` with the rows that break it."""
    both = in_context(rows, attacks)
    return ((rule, both.filter(broken.fill_null(False))) for rule, broken in RULES.items())


def check_rules(rows: pl.DataFrame, rules: Mapping[str, pl.Expr]) -> None:
    """Raise a DataError that names the first row that breaks a rule."""
    for rule, broken in rules.items():
        if (wrong := rows.filter(broken.fill_null(False))).height:
            where = cell_in_words(wrong.select(ROW_KEY).row(0))
            raise DataError(where, f"breaks the rule: {rule}; so do {wrong.height - 1} more rows")


def cell_in_words(cell: tuple[str, str, int]) -> str:
    """Name a cell of an untrusted file."""
    return f"sample '{plain(cell[0])}', {plain(cell[1])} severity {cell[2]}"

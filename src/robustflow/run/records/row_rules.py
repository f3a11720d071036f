"""Rules that follow from what the columns and the measures of rows declare; a row that breaks one was not measured or
was changed afterwards. Whether values are plausible is not judged: only measuring again shows whether they are right.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

import polars as pl

from ...attacks.ball import GREY_LEVELS
from ...attacks.registry import attack_spec
from ...attacks.result import FOLLOWED, WARNINGS
from ...core.arguments import SEVERITIES
from ...core.errors import DataError
from ...core.text import plain
from ...core.types import TRUTHS
from ...metrics.measures import ATTACK, CLEAN_MEASURES, CONFIDENCE, MEASURES, REGION_MEASURES, Measure
from ...metrics.regions import REGIONS
from ...metrics.rows import CLEAN, COLUMNS, ROW_KEY, ROW_SCHEMA, SIGNED

_UNSAFE = r"[\p{Cc}\p{Cf}\p{Co}\p{Zl}\p{Zp}]"
"""Characters that control a terminal or the direction of text."""
_CLOSE = 1e-9
"""Relative rounding error of a sum."""
_LARGEST_SUM = 1e18
_LOWEST = {"attack_way_gone": -_LARGEST_SUM, **dict.fromkeys(SIGNED, -1.0)}
"""Lowest value of each column that may be negative."""
_LARGEST = {"%": 1.0, "grey levels": 255.0}
"""Largest value of one pixel, by unit."""
_REQUIRED = (
    *("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width", "n_invalid", "n_all"),
    *("rcre_all_sum", "pred_magnitude_sum", "n_photometric", "photometric_sum", "photometric_still_sum"),
)
_WORDS = {"truth": TRUTHS, "attack_gradient": FOLLOWED, "attack_warnings": ["", *WARNINGS]}
"""The words that a column may contain, separated by commas."""


def _any(conditions: Iterable[pl.Expr]) -> pl.Expr:
    return pl.any_horizontal(condition.fill_null(False) for condition in conditions)


def _varies(column: str) -> pl.Expr:
    """Whether a sample has different values of a column in its rows."""
    return pl.col(column).min().over("sample") != pl.col(column).max().over("sample")


def _of_clean(column: str) -> pl.Expr:
    """The value in the sample's clean row."""
    return pl.when(corruption=CLEAN).then(column).max().over("sample")


SINGLE_ROW_RULES: dict[str, pl.Expr] = {
    "a cell has one row": pl.struct(ROW_KEY).is_duplicated(),
    "no cell of these columns is empty": _any(pl.col(name).is_null() for name in _REQUIRED),
    "names have 1 to 500 printable characters": _any(
        ~pl.col(name).str.len_chars().is_between(1, 500) | pl.col(name).str.contains(_UNSAFE)
        for name in ("sample", "group", "corruption")
    ),
    "digests have 32 hexadecimal digits, not all zero": _any(
        ~pl.col(name).str.contains("^[0-9a-f]{32}$") | pl.col(name).str.contains("^0+$")
        for name in ("frames_digest", "truth_digest")
    ),
    "words are known": _any(
        ~pl.col(name).str.split(",").list.eval(pl.element().is_in(words)).list.all() for name, words in _WORDS.items()
    ),
    "a digest of the truth is that of measured pixels": pl.col("truth_digest").is_null() != pl.col("n_valid").is_null(),
    "numbers are finite, not too large, and positive where they have to be": _any(
        ~pl.col(name).is_between(*((0, 2**53) if kind is pl.Int64 else (_LOWEST.get(name, 0.0), _LARGEST_SUM)))
        for name, kind in ROW_SCHEMA.items()
        if kind is not pl.String
    ),
}
"""Name of each rule of a row by itself -> condition under which a row breaks it."""


def row_rules(attacks: Collection[str] = ()) -> dict[str, pl.Expr]:
    """Return the rules of rows beside each other, by name: the condition under which a row breaks one.

    Args:
        attacks: names of the attacks among the corruptions of the rows.
    """
    pixels, is_attack = pl.col("height") * pl.col("width"), pl.col("corruption").is_in(list(attacks))
    declared: list[Mapping[str, Measure]] = [MEASURES, CLEAN_MEASURES, CONFIDENCE, ATTACK, *REGION_MEASURES.values()]
    averages = [part for measures in declared for name in measures for part in measures[name].parts]
    budgets = [
        pl.col("corruption").is_in([name for name in attacks if attack_spec(name).norm == norm])
        & (pl.col(f"attack_{norm}") > (1 + _CLOSE) * pl.col("severity").replace_strict(levels, default=None))
        for norm in ("linf", "rms")
        for levels in [dict(zip(SEVERITIES, GREY_LEVELS[norm], strict=True))]
    ]
    return {
        "sums and their counts are measured together": _any(
            pl.col(name).is_null() != pl.col(column.count).is_null() for name, column in COLUMNS.items() if column.count
        ),
        "no mean is beyond the range of its unit": _any(
            average.total > _LARGEST[average.unit] * average.count * (1 + _CLOSE)
            for average in averages
            if average.unit in _LARGEST
        ),
        "a frame has its pixels": _any(
            [
                pl.max_horizontal("n_all", "n_photometric") + pl.col("n_invalid") > pixels,
                pl.col("n_truth") > pixels,
                pl.col("n_valid") > pl.min_horizontal("n_all", "n_truth"),
            ]
        ),
        "errors exist if the corruption leaves the ground truth": pl.when(pl.col("truth") == "none")
        .then(_any(pl.col(name).is_not_null() for name in ("n_valid", *(f"n_{region}" for region in REGIONS))))
        .otherwise(pl.col("n_valid").is_null() & _of_clean("n_valid").is_not_null()),
        "rows of a sample have one size, group and ground truth": _any(
            map(_varies, ("height", "width", "group", "n_truth", "truth_digest"))
        ),
        "clean errors are those of the clean row": _any(
            (pl.col(count) == _of_clean(count)) & (pl.col(f"clean_{errors}") != _of_clean(errors))
            for count, errors in (("n_valid", "epe_sum"), *((f"n_{region}", f"epe_sum_{region}") for region in REGIONS))
        ),
        "only attacks have values of attacks, and all of them": pl.when(is_attack)
        .then(
            _any(pl.col(f"attack_{name}").is_null() for name in ("linf", "rms", "evaluations"))
            | (pl.col("n_valid") > 0) & _any(pl.col(f"attack_{name}").is_null() for name in ("capped_sum", "median"))
        )
        .otherwise(_any(pl.col(name).is_not_null() for name in ROW_SCHEMA if name.startswith("attack_"))),
        "attacks are within their budgets": _any(budgets),
    }


def broken_rules(rows: pl.DataFrame, rules: Mapping[str, pl.Expr]) -> Iterator[tuple[str, pl.DataFrame]]:
    """Yield each rule with the rows that break it."""
    return ((rule, rows.filter(broken.fill_null(False))) for rule, broken in rules.items())


def check_rules(rows: pl.DataFrame, rules: Mapping[str, pl.Expr]) -> None:
    """Raise a DataError that names the first row that breaks a rule."""
    for rule, wrong in broken_rules(rows, rules):
        if wrong.height:
            where = cell_in_words(wrong.select(ROW_KEY).row(0))
            raise DataError(where, f"breaks the rule: {rule}; so do {wrong.height - 1} more rows")


def cell_in_words(cell: tuple[str, str, int]) -> str:
    """Name a cell of an untrusted file."""
    return f"sample '{plain(cell[0])}', {plain(cell[1])} severity {cell[2]}"

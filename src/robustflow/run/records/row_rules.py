"""Rules that follow from the table of columns and the units of the measures; a row that breaks one was not measured, or
was changed afterwards. Whether values are plausible is not judged: only measuring again shows whether they are right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import polars as pl

from ...attacks.result import FOLLOWED, WARNINGS
from ...core.errors import DataError
from ...core.text import plain
from ...core.types import TRUTHS
from ...metrics.measures import ATTACK, CLEAN_MEASURES, CONFIDENCE, MEASURES, REGION_MEASURES, Measure
from ...metrics.rows import COLUMNS, ROW_KEY, ROW_SCHEMA, SIGNED

_UNSAFE = r"[\p{Cc}\p{Cf}\p{Co}\p{Zl}\p{Zp}]"
"""Characters that control a terminal or the direction of text."""
_CLOSE = 1e-9
"""Relative rounding error of a sum."""
_LARGEST_SUM = 1e18
_LOWEST = {"attack_way_gone": -_LARGEST_SUM, **dict.fromkeys(SIGNED, -1.0)}
"""Lowest value of each column that may be negative."""
_LARGEST = {"%": 1.0, "grey levels": 255.0}
"""Largest value of one pixel, by unit."""
_DECLARED: list[Mapping[str, Measure]] = [MEASURES, CLEAN_MEASURES, CONFIDENCE, ATTACK, *REGION_MEASURES.values()]
_AVERAGES = [
    part for measures in _DECLARED for measure in measures.values() for part in measure.parts if part.unit in _LARGEST
]
_REQUIRED = (
    *("sample", "group", "corruption", "severity", "truth", "frames_digest", "height", "width", "n_invalid", "n_all"),
    *("rcre_all_sum", "pred_magnitude_sum", "n_photometric", "photometric_sum", "photometric_still_sum"),
)
_WORDS = {"truth": TRUTHS, "attack_gradient": FOLLOWED, "attack_warnings": ["", *WARNINGS]}
"""The words that a column may contain, separated by commas."""


def _any(conditions: Iterable[pl.Expr]) -> pl.Expr:
    return pl.any_horizontal(condition.fill_null(False) for condition in conditions)


RULES: dict[str, pl.Expr] = {
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
    "sums and their counts are measured together": _any(
        pl.col(name).is_null() != pl.col(column.count).is_null() for name, column in COLUMNS.items() if column.count
    ),
    "no mean is beyond the range of its unit": _any(
        average.total > _LARGEST[average.unit] * average.count * (1 + _CLOSE) for average in _AVERAGES
    ),
}
"""Name of each rule -> condition under which a row breaks it."""


def check_rules(rows: pl.DataFrame) -> None:
    """Raise a DataError that names the first row that breaks a rule."""
    for rule, broken in RULES.items():
        if (wrong := rows.filter(broken.fill_null(False))).height:
            where = cell_in_words(wrong.select(ROW_KEY).row(0))
            raise DataError(where, f"breaks the rule: {rule}; so do {wrong.height - 1} more rows")


def cell_in_words(cell: tuple[str, str, int]) -> str:
    """Name a cell of an untrusted file."""
    return f"sample '{plain(cell[0])}', {plain(cell[1])} severity {cell[2]}"

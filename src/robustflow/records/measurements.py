"""Check a record's measurements: compare the summary with the rows, and find impossible rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any

import polars as pl

from ..metrics.rows import CLEAN
from .row_rules import RULES, broken_attack_rules, broken_rules

if TYPE_CHECKING:
    from ..runs.run import Run

_CLOSE = 1e-9


def summary_problems(summary: dict[str, Any], run: Run) -> tuple[list[str], int]:
    """Compare a summary with that of a run's rows; return the problems and the number of values."""
    values = [leaf for leaf in _leaves((), summary, run.document()) if leaf[0] != ("run",)]
    problems = [
        f"summary.json: {'.'.join(path)} is {_value_text(left)}, but according to the rows it is {_value_text(right)}"
        for path, left, right in values
        if not _equal_values(left, right)
    ]
    return problems, len(values)


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


_ABSENT = object()


def _leaves(path: tuple[str, ...], left: Any, right: Any) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """Yield the path of every leaf together with its value on each side; either value may be missing."""
    if isinstance(left, dict) and isinstance(right, dict):
        for name in dict.fromkeys((*left, *right)):
            yield from _leaves((*path, str(name)), left.get(name, _ABSENT), right.get(name, _ABSENT))
    elif isinstance(left, list) and isinstance(right, list) and len(left) == len(right):
        for index, (one, two) in enumerate(zip(left, right, strict=True)):
            yield from _leaves((*path, str(index)), one, two)
    else:
        yield path, left, right


def _equal_values(left: Any, right: Any) -> bool:
    one, two = _number(left), _number(right)
    if one is not None and two is not None:
        return math.isclose(one, two, rel_tol=_CLOSE, abs_tol=_CLOSE)
    return type(left) is type(right) and bool(left == right)


def _number(value: Any) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:  # an integer with hundreds of digits
        return None
    return number if math.isfinite(number) else None


def _value_text(value: Any) -> str:
    if value is _ABSENT:
        return "missing"
    return f"{value:.6g}" if _number(value) is not None else str(value)[:80]

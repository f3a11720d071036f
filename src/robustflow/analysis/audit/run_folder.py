"""Audit a run folder: compare the summary with the rows, and find impossible rows."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from ...bounded_file import read_bounded
from ...errors import RunError
from ...metrics.rows import CLEAN
from ...metrics.summary import SUMMARY_VERSION
from .findings import Audit, Finding, merged_audit
from .row_rules import RULES, broken_attack_rules, broken_rules

if TYPE_CHECKING:
    from ...runs.run import Run

_LARGEST_SUMMARY = 256 * 2**20
_CLOSE = 1e-9


def audit_run(run: Run, audited: str | None = None) -> Audit:
    """Check that the contents of a run folder are consistent with its rows.

    `summary.json` is recomputed from the rows and compared number by number, and rows are checked for impossible
    measurements (`row_rules.RULES`). Modified manifests are already rejected when the run is read.

    Args:
        run: run to audit.
        audited: name of the run in the result; the folder by default.

    Raises:
        DataError, RunError: if the folder has no readable summary.
    """
    return merged_audit(audited or str(run.path), [_summary(run), _rows(run)])


def _summary(run: Run) -> tuple[str, int, list[Finding]]:
    stored = _read_summary(run.path / "summary.json")
    count, findings = 0, []
    for path, left, right in _leaves((), stored, run.document()):
        if path == ("run",):
            continue
        count += 1
        if not _equal_values(left, right):
            where = ".".join(path)
            message = (
                f"summary.json: {where} is {_value_text(left)}, but according to the rows it is {_value_text(right)}"
            )
            findings.append(
                Finding(
                    check="summary",
                    source="summary.json",
                    corruption=dict(pairwise(path)).get("corruptions", ""),
                    given=_number(left),
                    recomputed=_number(right),
                    tolerance=_CLOSE,
                    message=message,
                )
            )
    return "summary", count, findings


def _read_summary(path: Path) -> dict[str, Any]:
    remedy = f"recreate it with robustflow show {path.parent}"
    data = read_bounded(path, _LARGEST_SUMMARY, remedy)
    try:
        summary = json.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path} cannot be read ({error}); {remedy}") from error
    if not isinstance(summary, dict):
        raise RunError(f"{path} is not a summary; {remedy}")
    if (version := summary.get("version")) != SUMMARY_VERSION:
        raise RunError(
            f"{path.name} has version {version}, but this version of robustflow reads {SUMMARY_VERSION}; "
            "recreate it with robustflow show"
        )
    return summary


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


def _rows(run: Run) -> tuple[str, int, list[Finding]]:
    findings = []
    rows, broken_rows = run.rows, [broken_rules(run.rows)]
    if run.attacks:
        attacked = run.attack_rows
        rows = pl.concat([rows, attacked.filter(pl.col("corruption") != CLEAN)])
        broken_rows = [broken_rules(rows, run.attacks), broken_attack_rules(attacked)]
    for reason, broken in chain.from_iterable(broken_rows):
        for row in broken.iter_rows(named=True):
            where = f"sample '{row['sample']}', {row['corruption']} severity {row['severity']}"
            message = f"rows: {where}: {reason}"
            findings.append(Finding(check="rows", source="rows", corruption=str(row["corruption"]), message=message))
    return "rows", rows.height * len(RULES), findings

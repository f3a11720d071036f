"""Find patterns among mismatches: swapped rows of two models, or values shifted by one column."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from ..model_result import ModelResult
from ..results import AVERAGE
from .checks import Values, below_change, change_tolerance, expected_cre, finding, misfits_change
from .findings import Finding, misfits

_LEAST = 3
"""Minimum number of matching values for a pattern."""


def check_swapped(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Find pairs of models in the same setting whose rows match each other's EPE but not their own."""
    count, findings = 0, []
    wrong = {line: _misfitting(line.values, line.values) for line in results}
    for first, second in combinations([line for line, names in wrong.items() if len(names) >= _LEAST], 2):
        if any(getattr(first, part) != getattr(second, part) for part in ("frames", "benchmark", "setting")):
            continue
        count += 1
        one, two = first.values, second.values
        crossed = _misfitting(one, two) + _misfitting(two, one)
        if crossed:
            continue
        cells = len(_comparable_names(one, two))
        rows = f"rows of {first.name} and {second.name} ({first.setting}) are swapped relative to their EPE rows"
        message = (
            f"the CRE {rows}: all {cells} values of each match the other's EPE; {len(wrong[first])} and "
            f"{len(wrong[second])} do not match their own"
        )
        findings.append(finding("swapped", first, "cre", "", message))
        own, other = _impossible(one, one) + _impossible(two, two), _impossible(one, two) + _impossible(two, one)
        if own and not other:
            message = (
                f"the RCRE {rows}: {own} values are impossible (RCRE below |EPE - clean EPE|) as printed, but none "
                "when swapped"
            )
            findings.append(finding("swapped", first, "rcre", "", message))
    return "swapped", count, findings


def check_shifted(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Find consecutive values of a model that match the neighbouring column but not their own."""
    count, findings = 0, []
    for line in results:
        values = line.values
        expected = expected_cre(values)
        names = [name for name in expected if name != AVERAGE and ("cre", name) in values]
        for step, side in ((1, "right"), (-1, "left")):
            run: list[str] = []
            for here, there in zip(names, names[step:] if step > 0 else [None, *names], strict=False):
                count += 1
                fits = there is not None and _fits_only_next_column(values, expected[here], here, there)
                if fits:
                    run.append(here)
                    continue
                findings += _shifted_rows(line, run, side)
                run = []
            findings += _shifted_rows(line, run, side)
    return "shifted", count, findings


def _shifted_rows(line: ModelResult, run: list[str], side: str) -> list[Finding]:
    if len(run) < _LEAST:
        return []
    message = (
        f"{line.setting} {line.name}: EPE - clean EPE for {', '.join(run)} equals the CRE one column to the {side} "
        "instead of the CRE in the same column: a row is shifted by one column in one of the tables"
    )
    return [finding("shifted", line, "epe", run[0], message)]


def _fits_only_next_column(values: Values, expected: float, here: str, there: str) -> bool:
    tolerance = change_tolerance(values, here, values["cre", here])
    return misfits(values["cre", here].number, expected, tolerance) and not misfits(
        values["cre", there].number, expected, tolerance
    )


def _comparable_names(epe: Values, cre: Values) -> list[str]:
    return [name for name in expected_cre(epe) if ("cre", name) in cre]


def _misfitting(epe: Values, cre: Values) -> list[str]:
    """List the corruptions for which the CRE of one row is inconsistent with the EPE of another."""
    return [name for name in _comparable_names(epe, cre) if misfits_change(epe, name, cre["cre", name])]


def _impossible(epe: Values, rcre: Values) -> int:
    """Count the RCRE values of one row that are below the change in EPE of another."""
    return sum(below_change(epe, name, rcre["rcre", name]) for name in expected_cre(epe) if ("rcre", name) in rcre)

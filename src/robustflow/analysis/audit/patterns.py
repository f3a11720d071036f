"""What many mismatches together suggest: the rows of two models were swapped, or values moved by one column."""

from __future__ import annotations

from itertools import combinations

from ..results import AVERAGE
from .checks import Book, ModelKey, PrintedValues, below_change, change_tolerance, expected_cre, misfits_change
from .findings import Finding
from .rounding import misfits

_LEAST = 3
"""With fewer numbers that happen to fit elsewhere, there is no pattern."""


def check_swapped(book: Book) -> tuple[str, int, list[Finding]]:
    """Rows of two models of a setting that fit each other's EPE, but not their own."""
    count, findings = 0, []
    wrong = {key: _misfitting(book.values[key], book.values[key]) for key in book.values}
    for first, second in combinations([key for key, names in wrong.items() if len(names) >= _LEAST], 2):
        if first[:3] != second[:3]:
            continue
        count += 1
        one, two = book.values[first], book.values[second]
        crossed = _misfitting(one, two) + _misfitting(two, one)
        if crossed:
            continue
        cells = len(_both(one, two))
        says = (
            f"the CRE rows of {first[3]} and {second[3]} ({first[2]}) are swapped against their EPE rows: all {cells} "
            f"values of each fit the EPE of the other; {len(wrong[first])} and {len(wrong[second])} misfit their own"
        )
        findings.append(book.finding("swapped", first, "cre", "", says))
        own, other = _impossible(one, one) + _impossible(two, two), _impossible(one, two) + _impossible(two, one)
        if own and not other:
            says = (
                f"the RCRE rows of {first[3]} and {second[3]} ({first[2]}) are swapped against their EPE rows: {own} "
                "values are impossible (RCRE below |EPE - clean EPE|) as they stand, none when exchanged"
            )
            findings.append(book.finding("swapped", first, "rcre", "", says))
    return "swapped", count, findings


def check_shifted(book: Book) -> tuple[str, int, list[Finding]]:
    """Consecutive values of a model that fit the neighbouring column, but not their own."""
    count, findings = 0, []
    for key, values in book.values.items():
        expected = expected_cre(values)
        names = [name for name in expected if name != AVERAGE and ("cre", name) in values]
        for step, side in ((1, "right"), (-1, "left")):
            run: list[str] = []
            for here, there in zip(names, names[step:] if step > 0 else [None, *names], strict=False):
                count += 1
                fits = there is not None and _fits_beside(values, expected[here], here, there)
                if fits:
                    run.append(here)
                    continue
                findings += _shift(book, key, run, side)
                run = []
            findings += _shift(book, key, run, side)
    return "shifted", count, findings


def _shift(book: Book, key: ModelKey, run: list[str], side: str) -> list[Finding]:
    if len(run) < _LEAST:
        return []
    says = (
        f"{key[2]} {key[3]}: EPE - clean EPE of {', '.join(run)} equals the CRE one column to the {side}, not its own: "
        "a row moved by a column in one of the tables"
    )
    return [book.finding("shifted", key, "epe", run[0], says)]


def _fits_beside(values: PrintedValues, expected: float, here: str, there: str) -> bool:
    tolerance = change_tolerance(values, here, values["cre", here])
    return misfits(values["cre", here].value, expected, tolerance) and not misfits(
        values["cre", there].value, expected, tolerance
    )


def _both(epe: PrintedValues, cre: PrintedValues) -> list[str]:
    return [name for name in expected_cre(epe) if ("cre", name) in cre]


def _misfitting(epe: PrintedValues, cre: PrintedValues) -> list[str]:
    """Corruptions at which the CRE of one row does not follow from the EPE of another."""
    return [name for name in _both(epe, cre) if misfits_change(epe, name, cre["cre", name])]


def _impossible(epe: PrintedValues, rcre: PrintedValues) -> int:
    """How many RCRE of one row are below the change of the EPE of another."""
    return sum(below_change(epe, name, rcre["rcre", name]) for name in expected_cre(epe) if ("rcre", name) in rcre)

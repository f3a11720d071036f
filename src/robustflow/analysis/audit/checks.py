"""Numbers of results that must follow from each other: CRE from EPE, averages, CREr, RCRE's lower bound, marks."""

from __future__ import annotations

from collections.abc import Iterator

import polars as pl

from ...corruptions.names import ORDER
from ..labels import METRIC_LABELS
from ..results import AVERAGE, CLEAN
from .findings import Finding
from .rounding import Printed, misfits, ratio_range

ModelKey = tuple[str, str, str, str]
"""(sample set, benchmark, setting, model)."""
PrintedValues = dict[tuple[str, str], Printed]
"""(metric, corruption) -> number."""


class Book:
    """Results by model, with the source of each number."""

    def __init__(self, results: pl.DataFrame) -> None:
        self.values: dict[ModelKey, PrintedValues] = {}
        self.marks: dict[ModelKey, dict[tuple[str, str], bool]] = {}
        self._sources: dict[tuple[ModelKey, str], str] = {}
        for row in results.iter_rows(named=True):
            key = (row["sample_set"], row["benchmark"], row["setting"], row["model"])
            cell = (row["metric"], row["corruption"])
            self.values.setdefault(key, {})[cell] = Printed(row["value"], row["decimals"])
            if row["marked"] is not None:
                self.marks.setdefault(key, {})[cell] = row["marked"]
            self._sources[key, row["metric"]] = row["source"]

    def finding(
        self,
        check: str,
        key: ModelKey,
        metric: str,
        corruption: str,
        says: str,
        numbers: tuple[float, float, float] | None = None,
    ) -> Finding:
        """A finding about one number of a model; `numbers` are given, recomputed and tolerance."""
        given, recomputed, tolerance = numbers or (None, None, None)
        return Finding(
            check=check,
            source=self._sources.get((key, metric), ""),
            setting=key[2],
            model=key[3],
            metric=metric,
            corruption=corruption,
            given=given,
            recomputed=recomputed,
            tolerance=tolerance,
            says=says,
        )


def expected_cre(values: PrintedValues) -> dict[str, float]:
    """corruption -> EPE - clean EPE."""
    if ("epe", CLEAN) not in values:
        return {}
    return {name: _change(values, name) for metric, name in values if metric == "epe" and name != CLEAN}


def change_tolerance(epe: PrintedValues, corruption: str, given: Printed) -> float:
    """How much the rounding of the EPE, the clean EPE and a number compared with their difference (CRE, RCRE) can add
    up to."""
    return epe["epe", corruption].half + epe["epe", CLEAN].half + given.half


def misfits_change(epe: PrintedValues, corruption: str, cre: Printed) -> bool:
    """Whether a CRE does not follow from these EPE."""
    return misfits(cre.value, _change(epe, corruption), change_tolerance(epe, corruption, cre))


def below_change(epe: PrintedValues, corruption: str, rcre: Printed) -> bool:
    """Whether an RCRE is impossible given these EPE: below |EPE - clean EPE|."""
    lowest = abs(_change(epe, corruption))
    return rcre.value < lowest and misfits(rcre.value, lowest, change_tolerance(epe, corruption, rcre))


def check_cre(book: Book) -> tuple[str, int, list[Finding]]:
    """CRE = EPE - clean EPE."""
    count, findings = 0, []
    for key, values in book.values.items():
        for corruption, expected in expected_cre(values).items():
            given = values.get(("cre", corruption))
            if given is None:
                continue
            count += 1
            if misfits_change(values, corruption, given):
                epe, clean = values["epe", corruption].value, values["epe", CLEAN].value
                says = (
                    f"{_where(key, corruption)}: CRE {given.value:.2f}, but EPE {epe:.2f} - clean EPE {clean:.2f} = "
                    f"{expected:.2f}"
                )
                numbers = (given.value, expected, change_tolerance(values, corruption, given))
                findings.append(book.finding("cre", key, "cre", corruption, says, numbers))
    return "cre", count, findings


def check_averages(book: Book) -> tuple[str, int, list[Finding]]:
    """The average of each metric is the mean over those corruptions with a place in tables that are listed."""
    count, findings = 0, []
    for key, metric, values in _metrics(book):
        given = values.get((metric, AVERAGE))
        parts = [values[metric, name] for name in ORDER if (metric, name) in values]
        if given is None or not parts:
            continue
        count += 1
        mean = sum(part.value for part in parts) / len(parts)
        tolerance = given.half + sum(part.half for part in parts) / len(parts)
        if misfits(given.value, mean, tolerance):
            says = (
                f"{_where(key, AVERAGE)}: {METRIC_LABELS[metric]} {given.value:.2f}, but the mean over "
                f"{len(parts)} corruptions is {mean:.3f}"
            )
            numbers = (given.value, mean, tolerance)
            findings.append(book.finding("average", key, metric, AVERAGE, says, numbers))
    return "average", count, findings


def check_crer(book: Book) -> tuple[str, int, list[Finding]]:
    """CREr = (EPE - clean EPE) / clean EPE, for results that list it."""
    count, findings = 0, []
    for key, values in book.values.items():
        clean = values.get(("epe", CLEAN))
        if clean is None or clean.value <= clean.half:
            continue
        for corruption in [name for metric, name in values if metric == "crer" and ("epe", name) in values]:
            given, epe = values["crer", corruption], values["epe", corruption]
            count += 1
            ratio = (epe.value - clean.value) / clean.value
            low, high = ratio_range((epe.value - clean.value, epe.half + clean.half), (clean.value, clean.half))
            tolerance = given.half + max(high - ratio, ratio - low)
            if misfits(given.value, ratio, tolerance):
                says = f"{_where(key, corruption)}: CREr {given.value:.2f}, but from its EPE it is {ratio:.3f}"
                numbers = (given.value, ratio, tolerance)
                findings.append(book.finding("crer", key, "crer", corruption, says, numbers))
    return "crer", count, findings


def check_bound(book: Book) -> tuple[str, int, list[Finding]]:
    """RCRE >= |EPE - clean EPE|: a flow cannot lose more accuracy than it moves (triangle inequality)."""
    count, findings = 0, []
    for key, values in book.values.items():
        for corruption, expected in expected_cre(values).items():
            given = values.get(("rcre", corruption))
            if given is None:
                continue
            count += 1
            if below_change(values, corruption, given):
                says = (
                    f"{_where(key, corruption)}: RCRE {given.value:.2f} is impossible with a change of the EPE by "
                    f"{expected:+.2f}; it is at least as large"
                )
                numbers = (given.value, abs(expected), change_tolerance(values, corruption, given))
                findings.append(book.finding("bound", key, "rcre", corruption, says, numbers))
    return "bound", count, findings


def check_marks(book: Book) -> tuple[str, int, list[Finding]]:
    """The smallest number of a column among the models of a setting is marked, and nothing else.

    Columns of settings in which nothing is marked at all (the paper's knowledge-driven methods) are not checked.
    """
    count, findings = 0, []
    for metric, peers in _settings(book):
        for corruption in dict.fromkeys(name for key in peers for m, name in book.marks[key] if m == metric):
            cell = (metric, corruption)
            numbers = {key: book.values[key][cell].value for key in peers if cell in book.marks[key]}
            least = min(numbers.values())
            best = [key[3] for key, value in numbers.items() if value == least]
            marked = [key[3] for key in numbers if book.marks[key][cell]]
            count += 1
            if set(best) == set(marked):
                continue
            first = next((key for key in numbers if key[3] in marked), next(iter(numbers)))
            shown = (
                ", ".join(f"{key[3]} {value:.2f}" for key, value in numbers.items() if key[3] in marked) or "nothing"
            )
            says = (
                f"{first[2]}, {corruption}: {METRIC_LABELS[metric]} marked best is {shown}, but the least is "
                f"{' and '.join(best)} {least:.2f}"
            )
            pair = (numbers[first], least, 0.0)
            findings.append(book.finding("best", first, metric, corruption, says, pair))
    return "best", count, findings


def _metrics(book: Book) -> Iterator[tuple[ModelKey, str, PrintedValues]]:
    for key, values in book.values.items():
        for metric in dict.fromkeys(metric for metric, _ in values):
            yield key, metric, values


def _settings(book: Book) -> Iterator[tuple[str, list[ModelKey]]]:
    """(metric, the models of one setting) for every metric and setting in which something is marked."""
    by_setting: dict[tuple[str, str, str, str], list[ModelKey]] = {}
    for key, marks in book.marks.items():
        for metric in dict.fromkeys(metric for metric, _ in marks):
            by_setting.setdefault((metric, *key[:3]), []).append(key)
    for (metric, *_), keys in by_setting.items():
        if any(book.marks[key][cell] for key in keys for cell in book.marks[key] if cell[0] == metric):
            yield metric, keys


def _where(key: ModelKey, corruption: str) -> str:
    return f"{key[2]} {key[3]}, {corruption}"


def _change(values: PrintedValues, corruption: str) -> float:
    return values["epe", corruption].value - values["epe", CLEAN].value

"""Check numbers that depend on each other: CRE, averages, CREr, the lower bound of RCRE, and marks of the best
values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ...core.text import counted
from ...corruptions.registry import PAPER_ORDER
from ..model_result import ModelResult, Value, ValueKey
from ..results import AVERAGE, CLEAN, METRIC_LABELS
from .findings import Finding, misfits, ratio_range

Values = Mapping[ValueKey, Value]


def finding(
    check: str,
    line: ModelResult,
    metric: str,
    corruption: str,
    message: str,
    numbers: tuple[float, float, float] | None = None,
) -> Finding:
    """Create a finding about one number for a model; `numbers` contains the given number, the recomputed number and the
    tolerance."""
    given, recomputed, tolerance = numbers or (None, None, None)
    return Finding(
        check=check,
        source=next((value.source for (of, _), value in line.values.items() if of == metric), ""),
        setting=line.setting,
        model=line.name,
        metric=metric,
        corruption=corruption,
        given=given,
        recomputed=recomputed,
        tolerance=tolerance,
        message=message,
    )


def expected_cre(values: Values) -> dict[str, float]:
    """Return EPE - clean EPE by corruption."""
    if ("epe", CLEAN) not in values:
        return {}
    return {name: _change(values, name) for metric, name in values if metric == "epe" and name != CLEAN}


def change_tolerance(epe: Values, corruption: str, given: Value) -> float:
    """Return the largest combined rounding error of the EPE, the clean EPE, and the CRE or RCRE that is compared with
    their difference."""
    return epe["epe", corruption].half + epe["epe", CLEAN].half + given.half


def misfits_change(epe: Values, corruption: str, cre: Value) -> bool:
    """Whether a CRE is inconsistent with these EPE values."""
    return misfits(cre.number, _change(epe, corruption), change_tolerance(epe, corruption, cre))


def below_change(epe: Values, corruption: str, rcre: Value) -> bool:
    """Whether an RCRE is impossible given these EPE values, that is, below |EPE - clean EPE|."""
    lowest = abs(_change(epe, corruption))
    return rcre.number < lowest and misfits(rcre.number, lowest, change_tolerance(epe, corruption, rcre))


def check_cre(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Check that CRE = EPE - clean EPE."""
    compared, findings = list(_changes_in_epe(results, "cre")), []
    for line, corruption, given, expected in compared:
        values = line.values
        if misfits_change(values, corruption, given):
            epe, clean = values["epe", corruption].number, values["epe", CLEAN].number
            message = (
                f"{_location(line, corruption)}: CRE {given.number:.2f}, but EPE {epe:.2f} - clean EPE {clean:.2f} = "
                f"{expected:.2f}"
            )
            numbers = (given.number, expected, change_tolerance(values, corruption, given))
            findings.append(finding("cre", line, "cre", corruption, message, numbers))
    return "cre", len(compared), findings


def check_averages(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Check that the average of each metric is the mean over all corruptions of its line, or over the paper's. If some
    corruptions have an EPE, those without one leave no ground truth, and averages do not include them."""
    count, findings = 0, []
    metrics = ((line, metric) for line in results for metric in dict.fromkeys(metric for metric, _ in line.values))
    for line, metric in metrics:
        given = line.values.get((metric, AVERAGE))
        with_truth = {name for of, name in line.values if of == "epe"} - {CLEAN, AVERAGE}
        parts = {
            name: value
            for (of, name), value in line.values.items()
            if of == metric and name not in (CLEAN, AVERAGE) and (name in with_truth or not with_truth)
        }
        if given is None or not parts:
            continue
        count += 1
        means = [
            (
                sum(part.number for part in chosen) / len(chosen),
                given.half + sum(part.half for part in chosen) / len(chosen),
            )
            for chosen in (list(parts.values()), [parts[name] for name in PAPER_ORDER if name in parts])
            if chosen
        ]
        if all(misfits(given.number, *mean) for mean in means):
            mean, tolerance = means[0]
            message = (
                f"{_location(line, AVERAGE)}: {METRIC_LABELS[metric]} {given.number:.2f}, but the mean over "
                f"{counted(len(parts), 'corruption')} is {mean:.3f}"
            )
            numbers = (given.number, mean, tolerance)
            findings.append(finding("average", line, metric, AVERAGE, message, numbers))
    return "average", count, findings


def check_crer(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Check that CREr = (EPE - clean EPE) / clean EPE, for results that contain a CREr."""
    count, findings = 0, []
    for line in results:
        values = line.values
        clean = values.get(("epe", CLEAN))
        if clean is None or clean.number <= clean.half or line.coverage is not None:
            continue
        for corruption in [name for metric, name in values if metric == "crer" and ("epe", name) in values]:
            given, epe = values["crer", corruption], values["epe", corruption]
            count += 1
            ratio = (epe.number - clean.number) / clean.number
            low, high = ratio_range((epe.number - clean.number, epe.half + clean.half), (clean.number, clean.half))
            tolerance = given.half + max(high - ratio, ratio - low)
            if misfits(given.number, ratio, tolerance):
                message = f"{_location(line, corruption)}: CREr {given.number:.2f}, but its EPE implies {ratio:.3f}"
                numbers = (given.number, ratio, tolerance)
                findings.append(finding("crer", line, "crer", corruption, message, numbers))
    return "crer", count, findings


def check_bound(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Check that RCRE >= |EPE - clean EPE|, which follows from the triangle inequality."""
    compared, findings = list(_changes_in_epe(results, "rcre")), []
    for line, corruption, given, expected in compared:
        if below_change(line.values, corruption, given):
            message = (
                f"{_location(line, corruption)}: RCRE {given.number:.2f} is impossible with a change in EPE of "
                f"{expected:+.2f}; RCRE must be at least as large"
            )
            numbers = (given.number, abs(expected), change_tolerance(line.values, corruption, given))
            findings.append(finding("bound", line, "rcre", corruption, message, numbers))
    return "bound", len(compared), findings


def _changes_in_epe(results: Sequence[ModelResult], metric: str) -> Iterator[tuple[ModelResult, str, Value, float]]:
    """Yield line, corruption, value and change in EPE for each value of a metric that can be compared with EPE. If a
    model did not predict all pixels, its clean and its corrupted EPE are over different pixels."""
    for line in results:
        if line.coverage is not None:
            continue
        for corruption, expected in expected_cre(line.values).items():
            if (given := line.values.get((metric, corruption))) is not None:
                yield line, corruption, given, expected


def check_marks(results: Sequence[ModelResult]) -> tuple[str, int, list[Finding]]:
    """Check that, among the models of one setting, exactly the smallest number in each column is marked."""
    count, findings = 0, []
    for metric, peers in _settings(results):
        for corruption in dict.fromkeys(name for line in peers for name in _marked_columns(line, metric)):
            cells = {
                line: value
                for line in peers
                if (value := line.values.get((metric, corruption))) is not None and value.marked is not None
            }
            least = min(value.number for value in cells.values())
            best = [line.name for line, value in cells.items() if value.number == least]
            marked = {line: value for line, value in cells.items() if value.marked}
            count += 1
            if set(best) == {line.name for line in marked}:
                continue
            first = next(iter(marked or cells))
            shown = ", ".join(f"{line.name} {value.number:.2f}" for line, value in marked.items()) or "nothing"
            message = (
                f"{first.setting}, {corruption}: {METRIC_LABELS[metric]} {shown} is marked as best, but the lowest is "
                f"{' and '.join(best)} {least:.2f}"
            )
            findings.append(finding("best", first, metric, corruption, message, (cells[first].number, least, 0.0)))
    return "best", count, findings


def _settings(results: Sequence[ModelResult]) -> Iterator[tuple[str, list[ModelResult]]]:
    """Yield (metric, models of one setting) for every metric and setting with at least one mark."""
    by_setting: dict[tuple[str, str, str, str], list[ModelResult]] = {}
    for line in results:
        for metric in dict.fromkeys(of for (of, _), value in line.values.items() if value.marked is not None):
            by_setting.setdefault((metric, line.frames, line.benchmark, line.setting), []).append(line)
    for (metric, *_), lines in by_setting.items():
        if any(value.marked for line in lines for (of, _), value in line.values.items() if of == metric):
            yield metric, lines


def _marked_columns(line: ModelResult, metric: str) -> list[str]:
    return [name for (of, name), value in line.values.items() if of == metric and value.marked is not None]


def _location(line: ModelResult, corruption: str) -> str:
    return f"{line.setting} {line.name}, {corruption}"


def _change(values: Values, corruption: str) -> float:
    return values["epe", corruption].number - values["epe", CLEAN].number

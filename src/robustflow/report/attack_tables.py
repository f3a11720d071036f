"""Tables of attacks: errors, security curves, and the correlation between robustness to corruptions and to attacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ..attacks.registry import attack_spec
from ..attacks.result import EXPLAINED
from ..core.errors import RunError, UsageError
from ..core.text import counted, joined, plain
from ..metrics.measures import LEADING
from ..run.comparable import named_runs
from ..run.run import Run
from ..stats.attacks import Prediction, budget_at_double, predictions, warnings_of
from ..stats.frame import results_frame
from ..stats.lines import Numbers, lines_of
from ..stats.ranking import LEAST_MODELS
from ..stats.results import CLEAN, LABELS, metric_label
from .table import Column, Row, Table, Wanted, condition_rows, differences_remark, number_text

_COLUMNS = (
    Column("budget", "{:g}", key=("attack_budget", None)),
    *(
        Column(metric_label(name), key=(name, None))
        for name in ("epe", "cre", "crer", "rcre", "px1", "px3", "px5", "fl", "attack_median", "attack_capped")
    ),
    Column("gain (px)", key=("attack_gain", None)),
    Column(metric_label("attack_way_gone"), key=("attack_way_gone", None)),
    Column("last quarter", key=("attack_late_gain", None)),
    Column("start spread", key=("attack_start_spread", None)),
    Column("L-inf", "{:.4g}", key=("attack_linf", None)),
    Column("RMS", "{:.4g}", key=("attack_rms", None)),
    Column("flows", "{:.0f}", key=("attack_evaluations", None)),
    Column("time (s)", key=("attack_seconds", None)),
)
SHORT = [column for column in _COLUMNS if column.key[0] in ("attack_budget", "epe", "cre", "rcre", "attack_gain")]
"""Columns that the terminal shows of a run."""
_NORMS = {"linf": "L-inf", "rms": "RMS", "area": "Area, % of the pixels"}
_REMARK = (
    "Adversarial attacks, not included in any mean over corruptions. Budgets are in grey levels (0 to 255) and apply "
    "to the 8-bit frames that were evaluated. Fl: pixels with an error above 3 px and 5 %. "
    "Median: over the pixels of a pair, averaged over pairs. Capped: "
    "error per pixel limited to the frame diagonal. Gain: error minus that under random noise of the same norm. "
    "Target progress: movement from the clean flow towards the attack's target. Last quarter: gain in the last quarter "
    "of the evaluations. Start spread: best minus worst random start (the error is that of the best). Both are in px, "
    "or in units of the attack's loss= option. L-inf, RMS: norms reached, in grey levels. Flows and time: per pair. "
    "An attack gives a lower bound on the worst-case error."
)
_CURVES = (
    "Mean error by budget in grey levels (0 to 255), with 95 % intervals over pairs or groups of pairs. Budget 0: the "
    "clean frames. Without ground truth, the error is the distance from the clean flow."
)
_WARNED = "at least one pair has a warning; see the table of attacks"
PREDICTION = "Does robustness to corruptions predict robustness to attacks?"


class CurvePoint(NamedTuple):
    """The error of a model at one budget of one attack."""

    attack: str
    norm: str
    budget: float
    metric: str
    error: float
    low: float | None
    high: float | None
    warned: bool


def security_points(numbers: Numbers) -> list[CurvePoint]:
    """Return each attack's curve over all budgets, starting with the clean frames."""
    metric = _error(numbers)
    # The distance from the clean flow is 0 on the clean frames for any model.
    clean = numbers.get((metric, CLEAN, None), {"value": 0.0, "low": None, "high": None})
    points = []
    for attack, levels in attacks_of(numbers).items():
        curve = [(0.0, clean, False)]
        for at in levels:
            if (row := numbers.get((metric, attack, at))) is not None:
                budget = numbers["attack_budget", attack, at]["value"]
                curve.append((budget, row, bool(warnings_of(numbers.means, attack, at))))
        for budget, row, warned in sorted(curve, key=lambda point: point[0]):
            ends = row["low"], row["high"]
            points.append(CurvePoint(attack, attack_spec(attack).norm, budget, metric, row["value"], *ends, warned))
    return points


def attacks_of(numbers: Numbers) -> dict[str, list[int]]:
    """Return the severities of each attack of a line, in the order of the run."""
    levels: dict[str, list[int]] = {}
    for measure, attack, severity in numbers:
        if measure == "attack_budget" and severity is not None:
            levels.setdefault(attack, []).append(severity)
    return levels


def _error(numbers: Numbers) -> str:
    attacks = attacks_of(numbers)
    return LEADING if any(of in attacks for measure, of, _ in numbers if measure == LEADING) else "rcre"


def attacks(wanted: Wanted) -> list[Table]:
    """Return a table for each run with attacks."""
    tables = (attack_table(numbers, plain(name)) for name, numbers in _attacked(wanted.runs).items())
    return _made("attacks", [table for table in tables if table])


def security(wanted: Wanted) -> list[Table]:
    """Tabulate the security curves of runs, one section per run."""
    try:
        sections = {plain(name): map(_curve_row, security_points(n)) for name, n in _attacked(wanted.runs).items()}
    except RunError as error:
        raise UsageError(str(error)) from error
    columns: list[str | Column] = ["norm", Column("budget", "{:g}"), "metric"]
    columns += [Column(label, "{:.3f}") for label in ("error (px)", "low", "high")]
    remarks = (_CURVES, differences_remark(named_runs(wanted.runs)))
    table = Table.of("security", "Security curves", columns, sections, remarks, "Attack, budget")
    return _made("security", [table] if table.lines else [])


def _attacked(runs: Sequence[Run]) -> dict[str, Numbers]:
    frame = results_frame(runs, ("means", "attacks"), detailed=False)
    return {key.model: numbers for key, numbers in lines_of(frame).items()}


def corruptions_and_attacks(wanted: Wanted) -> list[Table]:
    """Return the correlations between the errors under attacks and under corruptions."""
    try:
        table = prediction_table(wanted.runs)
    except RunError as error:
        raise UsageError(str(error)) from error
    return _made("corruptions-and-attacks", [table] if table else [])


def _made(name: str, tables: list[Table]) -> list[Table]:
    if not tables:
        needed = "two runs with attacks and corruptions" if name == "corruptions-and-attacks" else "a run with attacks"
        raise UsageError("--table", f"'{name}' needs {needed}: pass --attacks to robustflow run")
    return tables


def attack_table(numbers: Numbers, model: str = "", columns: Sequence[Column] = _COLUMNS) -> Table | None:
    """Tabulate every attack of a run at every severity; return None if the run has no attacks. Warnings are shown as
    notes on their rows. No value is marked as best."""
    cells = {f"{attack} {at}": (attack, at) for attack, levels in attacks_of(numbers).items() for at in levels}
    if not cells:
        return None
    made = condition_rows(numbers, columns, cells)
    rows = [row._replace(note=_warnings(numbers, *cells[row.label])) for row in made]
    sections = {
        title: [row for row in rows if attack_spec(cells[row.label][0]).norm == norm] for norm, title in _NORMS.items()
    }
    title = f"Attacks on {model}" if model else "Attacks"
    return Table.of("attacks", title, columns, sections, (_REMARK, _doubled(numbers)), "Attack, severity")


def _warnings(numbers: Numbers, attack: str, severity: int) -> str:
    pairs = numbers["attack_budget", attack, severity]["pairs"]
    warnings = warnings_of(numbers.means, attack, severity)
    return "; ".join(f"{EXPLAINED.get(key, key)} ({count} of {pairs} pairs)" for key, count in warnings.items())


def _doubled(numbers: Numbers) -> str:
    """Return the remark with the budget at which each attack doubles the error."""
    clean = numbers.number(LEADING, CLEAN)
    known = {attack: budget_at_double(numbers.means, attack, clean) for attack in attacks_of(numbers)}
    each = [
        f"{attack} {budget:.2g}{' %' if attack_spec(attack).norm == 'area' else ''}"
        for attack, budget in known.items()
        if budget is not None
    ]
    return f"The clean error doubles at (grey levels or % of the pixels): {', '.join(each)}." if each else ""


def _curve_row(point: CurvePoint) -> Row:
    values = (point.norm, point.budget, point.metric, point.error, point.low, point.high)
    return Row(f"{point.attack} {point.budget:g}", values, _WARNED if point.warned else "")


def prediction_table(runs: Sequence[Run]) -> Table | None:
    """For each attack, tabulate the rank correlation over models between errors under the attack and under corruptions.
    Return None if fewer than two runs have both.
    """
    predicted = predictions(runs)
    if not predicted:
        return None
    label = LABELS[predicted[0].metric]
    remarks = [
        f"Spearman's rank correlation over models between the mean {label} over corruptions and its value under the "
        "attack; interval by Fisher's z. All models are compared on the samples that they have in common. Left out: "
        "models that are not ranked, and values whose warnings indicate a masked gradient or a nondeterministic model.",
        predicted[0].remark,
    ]
    labels = ("severities", "models", "rank correlation", "95 % low", "95 % high")
    rows = map(_prediction_row, predicted)
    return Table.of("corruptions-and-attacks", PREDICTION, labels, {"Attacks": rows}, remarks, "Attack")


def _prediction_row(one: Prediction) -> Row:
    notes = list(_prediction_notes(one))
    levels = ", ".join(map(str, one.severities))
    ends = one.interval or (None, None)
    correlation = (number_text(value, "{:+.2f}") for value in (one.rho, *ends))
    return Row(one.attack, (levels, str(len(one.models)), *correlation), "; ".join(notes))


def _prediction_notes(one: Prediction) -> Iterator[str]:
    if len(one.models) < LEAST_MODELS:
        yield f"{counted(len(one.models), 'model')}: fewer than the {LEAST_MODELS} of a correlation"
    yield from (f"without {plain(name)}: {why}" for name, why in one.left_out.items())
    if one.lower_bounds:
        yield f"a lower bound for {joined(list(map(plain, one.lower_bounds)))}: see the warnings of each run"

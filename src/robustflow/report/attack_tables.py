"""Tables of attacks: errors, security curves, and the correlation between robustness to corruptions and to attacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..attacks.result import EXPLAINED
from ..core.errors import RunError, UsageError
from ..core.text import joined, plain
from ..run.comparable import named_runs
from ..run.run import Run
from ..stats.attacks import (
    AttackScore,
    CurvePoint,
    Prediction,
    attack_scores,
    budget_at_double,
    predictions,
    security_curves,
)
from ..stats.results import LABELS
from .run_tables import few_note, signed
from .table import Column, Row, Table, Wanted, differences_remark

_COLUMNS = {
    "budget": Column("budget", "{:g}"),
    "epe": Column("EPE (px)"),
    "cre": Column("CRE (px)"),
    "crer": Column("CREr"),
    "rcre": Column("RCRE (px)"),
    "px1": Column("> 1 px (%)"),
    "px3": Column("> 3 px (%)"),
    "px5": Column("> 5 px (%)"),
    "fl": Column("Fl (%)"),
    "median": Column("median (px)"),
    "capped": Column("capped (px)"),
    "gain": Column("gain (px)"),
    "way_gone": Column("target progress (%)"),
    "late_gain": Column("last quarter"),
    "start_spread": Column("start spread"),
    "linf": Column("L-inf", "{:.4g}"),
    "rms": Column("RMS", "{:.4g}"),
    "evaluations": Column("flows", "{:.0f}"),
    "seconds": Column("time (s)"),
}
"""Number of an attack -> its column."""
SHORT = ("budget", "epe", "cre", "rcre", "gain")
"""Numbers that the terminal shows of a run."""
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


def attacks(wanted: Wanted) -> list[Table]:
    """Return a table for each run with attacks."""
    each = [(title, attack_table(run)) for title, run in named_runs(wanted.runs).items()]
    return _made("attacks", [replace(table, title=f"Attacks on {plain(title)}") for title, table in each if table])


def security(wanted: Wanted) -> list[Table]:
    """Tabulate the security curves of runs, one section per run."""
    named = named_runs(wanted.runs)
    try:
        sections = {plain(name): map(_curve_row, security_curves(run)) for name, run in named.items()}
    except RunError as error:
        raise UsageError(str(error)) from error
    columns: list[str | Column] = ["norm", Column("budget", "{:g}"), "metric"]
    columns += [Column(label, "{:.3f}") for label in ("error (px)", "low", "high")]
    remarks = (_CURVES, differences_remark(named))
    table = Table.of("security", "Security curves", columns, sections, remarks, "Attack, budget")
    return _made("security", [table] if table.lines else [])


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


def attack_table(run: Run, shown: Sequence[str] = tuple(_COLUMNS)) -> Table | None:
    """Tabulate every attack of a run at every severity; return None if the run has no attacks. Warnings are shown as
    notes on their rows. No value is marked as best."""
    scores = attack_scores(run)
    if not scores:
        return None
    sections = {title: [_row(one, shown) for one in scores if one["norm"] == norm] for norm, title in _NORMS.items()}
    remarks = (_REMARK, _doubled(scores, run.epe_clean))
    return Table.of("attacks", "Attacks", [_COLUMNS[name] for name in shown], sections, remarks, "Attack, severity")


def _row(score: AttackScore, shown: Sequence[str]) -> Row:
    warnings = score["warnings"].items()
    note = "; ".join(f"{EXPLAINED.get(key, key)} ({count} of {score['samples']} pairs)" for key, count in warnings)
    return Row(f"{score['attack']} {score['severity']}", [score[name] for name in shown], note)


def _doubled(scores: Sequence[AttackScore], clean: float | None) -> str:
    """Return the remark with the budget at which each attack doubles the error."""
    norms = {score["attack"]: score["norm"] for score in scores}
    known = {name: budget_at_double(scores, name, clean) for name in norms}
    each = [
        f"{name} {budget:.2g}{' %' if norms[name] == 'area' else ''}"
        for name, budget in known.items()
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
    notes = [few_note(len(one.models)), *(f"without {plain(name)}: {why}" for name, why in one.left_out.items())]
    if one.lower_bounds:
        notes.append(f"a lower bound for {joined(list(map(plain, one.lower_bounds)))}: see the warnings of each run")
    levels = ", ".join(map(str, one.severities))
    values = (levels, str(len(one.models)), *signed(one.rho, one.interval))
    return Row(one.attack, values, "; ".join(filter(None, notes)))

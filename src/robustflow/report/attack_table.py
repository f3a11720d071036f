"""Tables of attacks: errors, security curves, and the correlation between robustness to corruptions and to attacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..attacks.result import EXPLAINED
from ..core.errors import RunError, UsageError
from ..core.text import counted, joined, plain
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
from ..stats.ranking import LEAST_MODELS
from ..stats.results import METRIC_LABELS
from ..stats.run_results import named_runs
from .table import DASH, Column, Line, Section, Table, differences_remark, number_text

_COLUMNS = (
    "budget",
    "EPE (px)",
    "CRE (px)",
    "CREr",
    "RCRE (px)",
    "> 1 px (%)",
    "> 3 px (%)",
    "> 5 px (%)",
    "Fl (%)",
    "median (px)",
    "capped (px)",
    "gain (px)",
    "target progress (%)",
    "last quarter",
    "start spread",
    "L-inf",
    "RMS",
    "flows",
    "time (s)",
)
_VALUES = (
    *("epe", "cre", "crer", "rcre", "px1", "px3", "px5", "fl"),
    *("median", "capped", "gain", "way_gone", "late_gain", "start_spread"),
)
_NORMS = {"linf": "L-inf", "rms": "RMS", "area": "Area, % of the pixels"}
_REMARK = (
    "Adversarial attacks, not included in any mean over corruptions. Budgets are in grey levels (0 to 255) and apply "
    "to the 8-bit frames that were evaluated. Median: median over the pixels of a pair, averaged over pairs. Capped: "
    "error per pixel limited to the frame diagonal. Gain: error minus that under random noise of the same norm. "
    "Target progress: movement from the clean flow towards the attack's target. Last quarter: gain in the last quarter "
    "of the evaluations. Start spread: best minus worst random start (the error is that of the best). Both are in px, "
    "or in units of the attack's loss= option. L-inf, RMS: norms reached, in grey levels. Flows and time: per pair. An "
    "attack gives a lower bound on the worst-case error; stronger attacks may "
    "exist."
)

_CURVES = (
    "Mean error by budget in grey levels (0 to 255), with 95 % intervals over pairs or groups of pairs. Budget 0 "
    "refers to the clean frames. Without ground truth, the error is the distance from the clean flow."
)
_WARNED = "at least one pair has a warning; see the table of attacks"
PREDICTION = "Does robustness to corruptions predict robustness to attacks?"

ATTACK_TABLES = ("attacks", "security", "corruptions-and-attacks")
"""Names of the tables that `attack_tables` can make."""


def attack_tables(name: str, runs: Sequence[Run], seed: int = 0) -> list[Table]:
    """Make one of `ATTACK_TABLES`; "attacks" results in one table per run with attacks."""
    if name == "attacks":
        each = [(title, attack_table(run)) for title, run in named_runs(runs).items()]
        tables = [replace(table, title=f"Attacks on {plain(title)}") for title, table in each if table is not None]
    else:
        try:
            table = security_table(runs, seed) if name == "security" else prediction_table(runs)
        except RunError as error:
            raise UsageError(str(error)) from error
        tables = [table] if table is not None else []
    if not tables:
        needed = "two runs with attacks and corruptions" if name == ATTACK_TABLES[-1] else "a run with attacks"
        raise UsageError(f"the table '{name}' needs {needed}: pass --attacks to robustflow run")
    return tables


def attack_table(run: Run) -> Table | None:
    """Tabulate every attack of a run at every severity; return None if the run has no attacks. Warnings are shown as
    notes on their rows. No value is marked as best."""
    scores = attack_scores(run)
    if not scores:
        return None
    sections = [
        Section(title, lines)
        for norm, title in _NORMS.items()
        if (lines := tuple(_line(score) for score in scores if score["norm"] == norm))
    ]
    remarks = filter(None, (_REMARK, _doubled(scores, run.epe_clean)))
    table = Table(
        "attacks", "Attacks", tuple(map(Column, _COLUMNS)), tuple(sections), tuple(remarks), "Attack, severity"
    )
    return table.without_empty_columns()


def _doubled(scores: Sequence[AttackScore], clean: float | None) -> str:
    """Return a sentence with the budget at which each attack doubles the error."""
    norms = {score["attack"]: score["norm"] for score in scores}
    known = {name: budget_at_double(scores, name, clean) for name in norms}
    each = [
        f"{name} {budget:.2g}{' %' if norms[name] == 'area' else ''}"
        for name, budget in known.items()
        if budget is not None
    ]
    return (
        f"The clean error doubles at these budgets, in grey levels or % of the pixels: {', '.join(each)}."
        if each
        else ""
    )


def _line(score: AttackScore) -> Line:
    values = (score[name] for name in _VALUES)
    reached = (f"{score['linf'] or 0.0:.4g}", f"{score['rms'] or 0.0:.4g}")
    seconds = number_text(score["seconds"], None)
    texts = (
        f"{score['budget']:g}",
        *(number_text(value, None) for value in values),
        *reached,
        f"{score['evaluations'] or 0.0:.0f}",
        seconds,
    )
    note = "; ".join(
        f"{explained(key)} ({count} of {score['samples']} pairs)" for key, count in score["warnings"].items()
    )
    return Line.of(f"{score['attack']} {score['severity']}", texts, note)


def explained(warning: str) -> str:
    """Return the text of a warning, or its key if this version does not know the warning."""
    return EXPLAINED.get(warning, warning)


def security_table(runs: Sequence[Run], seed: int = 0) -> Table | None:
    """Tabulate the security curves of runs, one section per run; return None if no run has attacks."""
    sections = []
    named = named_runs(runs)
    for name, run in named.items():
        if lines := tuple(map(_curve_line, security_curves(run, seed))):
            sections.append(Section(plain(name), lines))
    if not sections:
        return None
    columns = tuple(map(Column, ("norm", "budget", "metric", "error (px)", "low", "high")))
    remarks = (_CURVES, *differences_remark(named))
    return Table("security", "Security curves", columns, tuple(sections), remarks, "Attack, budget")


def prediction_table(runs: Sequence[Run]) -> Table | None:
    """For each attack, tabulate the rank correlation over models between errors under the attack and under corruptions.
    Return None if fewer than two runs have both.
    """
    predicted = predictions(runs)
    if not predicted:
        return None
    columns = tuple(map(Column, ("severities", "models", "rank correlation", "95 % low", "95 % high")))
    label = METRIC_LABELS[predicted[0].metric]
    remarks = [
        f"Spearman's rank correlation over models between the mean {label} over corruptions and its value under "
        "the attack; interval by Fisher's z. All models are compared on the samples that they have in common. "
        "Left out: models that are not ranked, and values whose warnings indicate a masked gradient or a "
        "nondeterministic model."
    ]
    if any(len(one.models) < LEAST_MODELS for one in predicted):
        remarks.append(f"No correlation is computed for fewer than {LEAST_MODELS} models.")
    if predicted[0].remark:
        remarks.append(predicted[0].remark)
    lines = tuple(map(_prediction_line, predicted))
    return Table("corruptions-and-attacks", PREDICTION, columns, (Section("Attacks", lines),), tuple(remarks), "Attack")


def _curve_line(point: CurvePoint) -> Line:
    values = (point.error, point.low, point.high)
    texts = (point.norm, f"{point.budget:g}", point.metric, *(number_text(value, 3) for value in values))
    label = f"{point.attack} {point.budget:g}"
    return Line.of(label, texts, _WARNED if point.warned else "")


def _prediction_line(one: Prediction) -> Line:
    low, high = one.interval or (None, None)
    texts = [", ".join(map(str, one.severities)), str(len(one.models))]
    texts += [DASH if value is None else f"{value:+.2f}" for value in (one.rho, low, high)]
    notes = [f"without {plain(name)}: {why}" for name, why in one.left_out.items()]
    if one.lower_bounds:
        notes.append(
            f"only a lower bound for {joined(list(map(plain, one.lower_bounds)))}: see the warnings of each run"
        )
    note = "; ".join(notes)
    if len(one.models) < LEAST_MODELS:
        note = "; ".join(filter(None, (f"{counted(len(one.models), 'model')}: too few for a correlation", note)))
    return Line.of(one.attack, texts, note)

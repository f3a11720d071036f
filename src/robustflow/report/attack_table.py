"""Attacks of a run as a table."""

from __future__ import annotations

from collections.abc import Sequence

from ..analysis.attacks import AttackScore, attack_scores, budget_at_double
from ..attacks.result import BESIDE_OTHERS, WARNINGS
from ..runs.run import Run
from .table import Column, Line, Section, Table, TableCell, number_text

_COLUMNS = (
    "budget",
    "EPE (px)",
    "CRE (px)",
    "CREr",
    "RCRE (px)",
    "> 3 px (%)",
    "capped (px)",
    "gain (px)",
    "flows",
)
_NORMS = {"linf": "L-inf", "rms": "RMS"}
_REMARK = (
    "Adversarial attacks, which no mean over corruptions includes. Budgets are grey levels of 255 and hold for the "
    "8-bit frames that were measured. Capped: no pixel counts more than the frame's diagonal. Gain: above random noise "
    "of the same norm. Flows: asked for per sample. An attack is a lower bound: a stronger one may exist."
)


def attack_table(run: Run) -> Table | None:
    """Every attack of a run at every severity; None if it has none. A line with a warning carries it as its note; none
    is marked as best."""
    scores = attack_scores(run)
    if not scores:
        return None
    sections = [
        Section(title, lines)
        for norm, title in _NORMS.items()
        if (lines := tuple(_line(score) for score in scores if score.norm == norm))
    ]
    remarks = filter(None, (_REMARK, _doubled(scores, run.epe_clean)))
    table = Table(
        "attacks", "Attacks", tuple(map(Column, _COLUMNS)), tuple(sections), tuple(remarks), "Attack, severity"
    )
    return table.without_empty_columns()


def _doubled(scores: Sequence[AttackScore], clean: float | None) -> str:
    """At which budget each attack doubles the error, in words."""
    known = {name: budget_at_double(scores, name, clean) for name in dict.fromkeys(score.attack for score in scores)}
    each = [f"{name} {budget:.2g}" for name, budget in known.items() if budget is not None]
    return f"The clean error doubles at these budgets, in grey levels: {', '.join(each)}." if each else ""


def _line(score: AttackScore) -> Line:
    values = (score.epe, score.cre, score.crer, score.rcre, score.px3, score.capped, score.gain)
    texts = (f"{score.budget:g}", *(number_text(value, None) for value in values), f"{score.evaluations:.0f}")
    note = "; ".join(f"{explained(key)} ({count} of {score.samples})" for key, count in score.warnings.items())
    return Line(f"{score.attack} {score.severity}", tuple(map(TableCell, texts)), note)


def explained(warning: str) -> str:
    """A warning in words; its name where a run of a different version wrote it.

    >>> explained("gradient_zero")
    'the gradient was zero everywhere: the model may hide it'
    """
    return {**WARNINGS, **BESIDE_OTHERS}.get(warning, warning)

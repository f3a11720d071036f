"""Scores of a model under attack: errors, gain over random noise of the same norm, cost, and warnings. Security
curves: the error of a model as a function of the attack's budget, with intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from ..attacks.ball import GREY_LEVELS
from ..attacks.registry import control_of, norm_of
from ..metrics.rows import CLEAN, ROW_KEY
from ..metrics.summary import Scores
from ..run.aggregate import summarize
from ..run.means import image_mean
from ..run.run import Run
from ..run.store import RunFolder
from .uncertainty import intervals

WHITE_BOX = ("bim", "pgd", "cospgd", "apgd")
"""Iterative gradient-based attacks, which a gradient-free attack should not outperform."""

_BEATEN = {
    "fgsm": "fgsm_above_iterative",
    "square": "square_above_white_box",
    "transfer": "transfer_above_white_box",
}
"""Attack -> key in `BESIDE_OTHERS` of the warning given to white-box attacks that are weaker than this attack."""


class AttackScore(Scores):
    """Scores of one attack at one severity: means over images, as for corruptions, and what only attacks have."""

    attack: str
    severity: int
    norm: str
    budget: float
    samples: int
    median: float | None
    capped: float | None
    way_gone: float | None
    late_gain: float | None
    start_spread: float | None
    gain: float | None = None
    linf: float
    rms: float
    evaluations: float
    seconds: float | None
    warnings: dict[str, int]

    @property
    def strength(self) -> float | None:
        """The EPE, or the RCRE if there is no ground truth, px."""
        return self.rcre if self.epe is None else self.epe


def attack_scores(run: Run) -> list[AttackScore]:
    """Score every attack of a run at every severity, starting with the controls."""
    rows = run.attack_rows
    names = [name for name in run.attacks if not rows.filter(corruption=name).is_empty()]
    if not names:
        return []
    means = summarize(rows, paper=()).corruptions
    scores = []
    for name in names:
        of_attack, spent = means[name], _seconds(run, name)
        for place, severity in enumerate(of_attack.severities):
            attack_rows = rows.filter(corruption=name, severity=severity)
            at: dict[str, Any] = {metric: values[place] for metric, values in of_attack.by_severity.items()}
            warnings = pl.Series(attack_rows["attack_warnings"]).str.split(",").explode().drop_nulls()
            counts = {text: int((warnings == text).sum()) for text in warnings.unique().sort() if text}
            norm = norm_of(name)
            scores.append(
                AttackScore(
                    attack=name,
                    severity=severity,
                    norm=norm,
                    budget=GREY_LEVELS[norm][severity - 1],
                    samples=attack_rows.height,
                    median=_mean(attack_rows, "attack_median"),
                    capped=image_mean(attack_rows, "attack_capped_sum", "n_valid"),
                    way_gone=_mean(attack_rows, "attack_way_gone", 100.0),
                    late_gain=_mean(attack_rows, "attack_late_gain"),
                    start_spread=_mean(attack_rows, "attack_start_spread"),
                    linf=_mean(attack_rows, "attack_linf") or 0.0,
                    rms=_mean(attack_rows, "attack_rms") or 0.0,
                    evaluations=_mean(attack_rows, "attack_evaluations") or 0.0,
                    seconds=spent,
                    warnings=counts,
                    **at,
                )
            )
    return _compared(scores)


def _seconds(run: Run, name: str) -> float | None:
    """Return the time per attacked pair, over everything in the run's folder, which is what its manifest counts."""
    spent, rows = run.manifest.seconds.get(f"attack {name}"), RunFolder(run.path).rows(ROW_KEY, name).height
    return spent / rows if spent is not None and rows else None


def budget_at_double(scores: Sequence[AttackScore], attack: str, clean: float | None) -> float | None:
    """Find the budget in grey levels at which an attack doubles the clean error, interpolated linearly between
    severities.
    """
    if not clean:
        return None
    before = (0.0, clean)
    for score in sorted((one for one in scores if one.attack == attack), key=lambda one: one.budget):
        if score.epe is None:
            return None
        if score.epe >= 2 * clean:
            share = (2 * clean - before[1]) / (score.epe - before[1])
            return before[0] + share * (score.budget - before[0])
        before = (score.budget, score.epe)
    return None


def _compared(scores: list[AttackScore]) -> list[AttackScore]:
    """Add the gain over noise and the warnings that depend on the scores of several attacks."""
    by_cell = {(score.attack, score.severity): score.strength for score in scores}
    compared = []
    for score in scores:
        noise = by_cell.get((control_of(score.attack), score.severity))
        known = score.strength is not None and noise is not None and score.attack != control_of(score.attack)
        gain = score.strength - noise if known else None  # type: ignore[operator]
        warnings = dict(score.warnings)
        if _name(score) in WHITE_BOX and score.way_gone is None:
            stronger = (one for one in scores if _is_stronger(one, score) and one.way_gone is None)
            warnings |= dict.fromkeys((_BEATEN[_name(one)] for one in stronger if _name(one) in _BEATEN), score.samples)
        compared.append(score.model_copy(update={"gain": gain, "warnings": warnings}))
    return compared


def _name(score: AttackScore) -> str:
    """The name of the attack without its options."""
    return score.attack.partition(":")[0]


def _is_stronger(one: AttackScore, other: AttackScore) -> bool:
    """Whether `one` is stronger than `other` at the same budget, in the same frames."""
    alike = (control_of(one.attack), one.severity) == (control_of(other.attack), other.severity)
    return alike and one.strength is not None and other.strength is not None and one.strength > other.strength


def _mean(rows: pl.DataFrame, column: str, factor: float = 1.0) -> float | None:
    """Return the mean of a column over images; None if the column is empty."""
    value = rows[column].mean()
    return factor * float(value) if isinstance(value, int | float) else None


@dataclass(frozen=True)
class CurvePoint:
    """The error of a model at one budget of one attack."""

    attack: str
    norm: str
    budget: float
    metric: str
    error: float
    low: float | None
    high: float | None
    warned: bool


def security_curves(run: Run, seed: int = 0) -> list[CurvePoint]:
    """Compute each attack's curve over all budgets, starting with the clean frames; the attacks are in the order of the
    run.
    """
    scores = attack_scores(run)
    if not scores:
        return []
    metric = "rcre" if scores[0].epe is None else "epe"
    table = intervals(run.attack_rows, seed=seed, severities=True, metrics=[metric])
    ends = {
        (corruption, severity): (estimate, low, high)
        for corruption, severity, estimate, low, high in table.filter(
            pl.col("severity").is_not_null() | (pl.col("corruption") == CLEAN)
        )
        .select("corruption", "severity", "estimate", "low", "high")
        .iter_rows()
    }
    points = []
    for name, norm in dict.fromkeys((score.attack, score.norm) for score in scores):
        # The distance from the clean flow is 0 on the clean frames for any model.
        clean = ends.get((CLEAN, None), (0.0, None, None))
        points.append(CurvePoint(name, norm, 0.0, metric, *clean, warned=False))
        for score in sorted((one for one in scores if one.attack == name), key=lambda one: one.budget):
            if (name, score.severity) in ends:
                here = ends[name, score.severity]
                points.append(CurvePoint(name, norm, score.budget, metric, *here, warned=bool(score.warnings)))
    return points

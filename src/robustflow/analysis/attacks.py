"""What attacks did to a model: errors, the gain over random noise of the same norm, costs, and warnings about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import polars as pl

from ..attacks.ball import GREY_LEVELS
from ..attacks.registry import control_of, norm_of
from ..runs.aggregate import summarize
from ..runs.run import Run

WHITE_BOX = ("bim", "pgd", "cospgd", "apgd")
"""Iterative attacks on the gradient, which an attack without it should not beat."""

_BEATEN = {
    "fgsm": "fgsm_above_iterative",
    "square": "square_above_white_box",
    "transfer": "transfer_above_white_box",
}
"""Attack -> the warning of a white-box attack that it beats, a key of `BESIDE_OTHERS`."""


@dataclass(frozen=True)
class AttackScore:
    """One attack at one severity.

    Attributes:
        attack, severity: which.
        norm, budget: "linf" or "rms", and grey levels of 255.
        samples: attacked.
        epe, cre, crer: mean error, its increase over the clean one, px, and that over the clean error; None without
            ground truth.
        rcre: mean change of the flow, px.
        px1, px3, px5, fl: shares of pixels that are off by more than 1, 3 and 5 px, and by KITTI's Fl, %; None without
            ground truth.
        median: mean over samples of the median error, px; None without ground truth.
        capped: mean error with each pixel counted up to the frame's diagonal, px; None without ground truth.
        way_gone: share of the way from the clean flow to the target, %; None without a target.
        gain: the error (the change, without ground truth) above that of random noise of the same norm, px.
        linf, rms: mean norms that were reached, grey levels.
        evaluations: mean number of flows asked for.
        seconds: mean time of the attack at any severity; None if the run does not say.
        warnings: key -> number of samples that carry it.
    """

    attack: str
    severity: int
    norm: str
    budget: float
    samples: int
    epe: float | None
    cre: float | None
    crer: float | None
    rcre: float | None
    px1: float | None
    px3: float | None
    px5: float | None
    fl: float | None
    median: float | None
    capped: float | None
    way_gone: float | None
    gain: float | None
    linf: float
    rms: float
    evaluations: float
    seconds: float | None
    warnings: dict[str, int]

    @property
    def strength(self) -> float | None:
        """The error, or the change where there is no ground truth, px."""
        return self.rcre if self.epe is None else self.epe


def attack_scores(run: Run) -> list[AttackScore]:
    """Every attack of a run at every severity, controls first; means over images, as for corruptions."""
    rows = run.attack_rows
    names = [name for name in run.attacks if not rows.filter(corruption=name).is_empty()]
    if not names:
        return []
    means = summarize(rows, paper=()).corruptions
    scores = []
    for name in names:
        of_attack, spent = means[name], run.manifest.seconds.get(f"attack {name}")
        for place, severity in enumerate(of_attack.severities):
            mine = rows.filter(corruption=name, severity=severity)
            at = {metric: values[place] for metric, values in of_attack.by_severity.items()}
            warnings = pl.Series(mine["attack_warnings"]).str.split(",").explode().drop_nulls()
            counts = {text: int((warnings == text).sum()) for text in warnings.unique().sort() if text}
            norm = norm_of(name)
            scores.append(
                AttackScore(
                    attack=name,
                    severity=severity,
                    norm=norm,
                    budget=GREY_LEVELS[norm][severity - 1],
                    samples=mine.height,
                    epe=at["epe"],
                    cre=at["cre"],
                    crer=at["crer"],
                    rcre=at["rcre"],
                    px1=_share(mine, "px1_count"),
                    px3=_share(mine, "px3_count"),
                    px5=_share(mine, "px5_count"),
                    fl=_share(mine, "fl_count"),
                    median=_mean(mine, "attack_median"),
                    capped=_share(mine, "attack_capped_sum", 1.0),
                    way_gone=_mean(mine, "attack_way_gone", 100.0),
                    gain=None,
                    linf=_mean(mine, "attack_linf") or 0.0,
                    rms=_mean(mine, "attack_rms") or 0.0,
                    evaluations=_mean(mine, "attack_evaluations") or 0.0,
                    seconds=None if spent is None else spent / rows.filter(corruption=name).height,
                    warnings=counts,
                )
            )
    return _compared(scores)


def budget_at_double(scores: Sequence[AttackScore], attack: str, clean: float | None) -> float | None:
    """The budget in grey levels at which an attack doubles the clean error, between severities in a straight line.

    Args:
        scores: of `attack_scores`.
        attack: its name.
        clean: mean error on the clean frames, px.

    Returns:
        None if no severity that was run doubles it, or without ground truth.
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
    """Add the gain over noise, and the warnings that follow from several attacks."""
    by_cell = {(score.attack, score.severity): score.strength for score in scores}
    compared = []
    for score in scores:
        noise = by_cell.get((control_of(score.attack), score.severity))
        known = score.strength is not None and noise is not None and score.attack != control_of(score.attack)
        gain = score.strength - noise if known else None  # type: ignore[operator]
        warnings = dict(score.warnings)
        if _name(score) in WHITE_BOX and score.way_gone is None:
            stronger = (one for one in scores if _above(one, score) and one.way_gone is None)
            warnings |= dict.fromkeys((_BEATEN[_name(one)] for one in stronger if _name(one) in _BEATEN), score.samples)
        compared.append(replace(score, gain=gain, warnings=warnings))
    return compared


def _name(score: AttackScore) -> str:
    """The attack without its options."""
    return score.attack.partition(":")[0]


def _above(one: AttackScore, other: AttackScore) -> bool:
    """Whether one is stronger at the same budget."""
    alike = (one.norm, one.severity) == (other.norm, other.severity)
    return alike and one.strength is not None and other.strength is not None and one.strength > other.strength


def _share(rows: pl.DataFrame, total: str, factor: float = 100.0) -> float | None:
    """Mean over images of a sum per pixel."""
    measured = rows.filter(pl.col("n_valid") > 0)
    value = (factor * measured[total] / measured["n_valid"]).mean()
    return float(value) if isinstance(value, float) else None


def _mean(rows: pl.DataFrame, column: str, factor: float = 1.0) -> float | None:
    """Mean of a column over images; None if it is empty."""
    value = rows[column].mean()
    return factor * float(value) if isinstance(value, int | float) else None

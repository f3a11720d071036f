"""Models under attack: errors, gain over random noise of the same norm, warnings, the error as a function of the
attack's budget, and the rank correlation with robustness to corruptions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from ..attacks.ball import GREY_LEVELS
from ..attacks.registry import attack_spec
from ..attacks.result import EXPLAINED, LOWER_BOUND
from ..metrics.cube import AVERAGE, Cube
from ..metrics.measures import ATTACK, MEASURES, METRICS
from ..metrics.rows import CLEAN, ROW_KEY
from ..run.comparable import MEASURED, common_cells, common_to, named_runs
from ..run.run import Run
from ..run.store import RunFolder
from .estimate import cubes_of, estimate, scopes_of
from .exclusion import exclusions
from .ranking import rank_correlation

AttackScore = dict[str, Any]
"""The numbers of one attack at one severity: `attack`, `severity`, `norm`, `budget`, `samples`, the metrics, the
measures of `ATTACK` without their prefix, `gain` over noise, `seconds` per pair, and `warnings`: key -> pairs."""


def attack_scores(run: Run) -> list[AttackScore]:
    """Score every attack of a run at every severity, starting with the controls."""
    rows, scores = run.attack_rows, []
    known = Cube.of(rows).means(MEASURES | ATTACK) if run.attacks else {}
    for name in run.attacks:
        norm, spent = attack_spec(name).norm, _seconds(run, name)
        for (severity,), part in (
            rows.filter(corruption=name).sort("severity").group_by("severity", maintain_order=True)
        ):
            at = name, severity
            warnings = Counter(",".join(part["attack_warnings"].drop_nulls()).split(","))
            scores.append(
                {
                    **{metric: known.get((metric, *at)) for metric in METRICS},
                    "attack": name,
                    "severity": severity,
                    "norm": norm,
                    "budget": GREY_LEVELS[norm][severity - 1],
                    "samples": part.height,
                    **{one.removeprefix("attack_"): known.get((one, *at)) for one in ATTACK},
                    "gain": None,
                    "seconds": spent,
                    "warnings": {text: count for text, count in sorted(warnings.items()) if text},
                }
            )
    return compared(scores)


def _seconds(run: Run, name: str) -> float | None:
    """Return the time per attacked pair, over everything in the run's folder, which is what its manifest counts."""
    spent, rows = run.manifest.seconds.get(f"attack {name}"), RunFolder(run.path).rows(ROW_KEY, name).height
    return spent / rows if spent is not None and rows else None


def strength(score: AttackScore) -> float | None:
    """Return the EPE, or the RCRE if there is no ground truth, in pixels."""
    value: float | None = score["rcre"] if score["epe"] is None else score["epe"]
    return value


def compared(scores: Sequence[AttackScore]) -> list[AttackScore]:
    """Add the gain over noise and the warnings that depend on the scores of several attacks."""
    by_cell = {(score["attack"], score["severity"]): strength(score) for score in scores}
    out = []
    for score in scores:
        spec, error = attack_spec(score["attack"]), strength(score)
        noise = None if spec.control == score["attack"] else by_cell.get((spec.control, score["severity"]))
        warnings = dict(score["warnings"])
        if spec.kind is not None and spec.kind.needs_gradients and not spec.kind.above and score["way_gone"] is None:
            stronger = (one for one in scores if _is_stronger(one, score) and one["way_gone"] is None)
            kinds = (attack_spec(one["attack"]).kind for one in stronger)
            warnings |= {kind.above: score["samples"] for kind in kinds if kind is not None and kind.above}
        gain = None if error is None or noise is None else error - noise
        out.append({**score, "gain": gain, "warnings": warnings})
    return out


def _is_stronger(one: AttackScore, other: AttackScore) -> bool:
    """Whether `one` is stronger than `other` at the same budget, in the same frames."""
    controls = [(attack_spec(score["attack"]).control, score["severity"]) for score in (one, other)]
    first, second = strength(one), strength(other)
    return controls[0] == controls[1] and first is not None and second is not None and first > second


def budget_at_double(scores: Sequence[AttackScore], attack: str, clean: float | None) -> float | None:
    """Find the budget in grey levels at which an attack doubles the clean error, interpolated linearly between
    severities.
    """
    if not clean:
        return None
    budget, error = 0.0, clean
    for score in sorted((one for one in scores if one["attack"] == attack), key=lambda one: one["budget"]):
        if score["epe"] is None:
            return None
        if score["epe"] >= 2 * clean:
            share = (2 * clean - error) / (score["epe"] - error)
            return float(budget + share * (score["budget"] - budget))
        budget, error = score["budget"], score["epe"]
    return None


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


def security_curves(run: Run) -> list[CurvePoint]:
    """Compute each attack's curve over all budgets, starting with the clean frames; the attacks are in the order of the
    run.
    """
    scores = attack_scores(run)
    if not scores:
        return []
    metric = "rcre" if scores[0]["epe"] is None else "epe"
    (cube,) = cubes_of({"": run.attack_rows}).values()
    table = estimate(cube, {metric: MEASURES[metric]}, scopes_of(cube, severities=True))
    ends = {(row["condition"], row["severity"]): (row["value"], row["low"], row["high"]) for row in table.to_dicts()}
    # The distance from the clean flow is 0 on the clean frames for any model.
    clean = ends.get((CLEAN, None), (0.0, None, None))
    points = []
    for name, norm in dict.fromkeys((score["attack"], score["norm"]) for score in scores):
        points.append(CurvePoint(name, norm, 0.0, metric, *clean, warned=False))
        for score in sorted((one for one in scores if one["attack"] == name), key=lambda one: one["budget"]):
            if (name, score["severity"]) in ends:
                here = ends[name, score["severity"]]
                points.append(CurvePoint(name, norm, score["budget"], metric, *here, warned=bool(score["warnings"])))
    return points


@dataclass(frozen=True)
class Prediction:
    """Rank correlation between robustness to one attack and robustness to corruptions, over several models."""

    attack: str
    severities: tuple[int, ...]
    metric: str
    models: tuple[str, ...]
    left_out: dict[str, str]
    lower_bounds: tuple[str, ...]
    rho: float | None
    interval: tuple[float, float] | None
    remark: str


def predictions(runs: Sequence[Run]) -> list[Prediction]:
    """Compute the rank correlation for every attack that at least two runs have in common, in order of appearance."""
    every = named_runs(runs)
    named = {name: run for name, run in every.items() if run.attacks and run.manifest.corruptions}
    if len(named) < 2:
        return []
    unranked = {name: why for name, why in zip(every, exclusions(runs), strict=True) if why}
    warned = {
        name: {(score["attack"], score["severity"]): set(score["warnings"]) for score in attack_scores(run)}
        for name, run in named.items()
    }
    metric = "rcre" if any(run.cre is None for run in named.values()) else "cre"
    common = common_to(named)
    samples = set.intersection(*(set(rows.filter(corruption=CLEAN)["sample"]) for rows in common.rows.values()))
    increase = {name: _mean(rows, metric, AVERAGE) for name, rows in common.rows.items()}
    predicted = []
    for attack in dict.fromkeys(attack for run in named.values() for attack in run.attacks):
        attacked = _common_rows(named, attack, samples)
        if len(attacked) < 2:
            continue
        shared = sorted(set(next(iter(attacked.values())).filter(corruption=attack)["severity"]))
        warnings = {
            name: {key for level in shared for key in warned[name].get((attack, level), ())} for name in attacked
        }
        left_out = {name: unranked[name] for name in attacked if name in unranked}
        for name, keys in warnings.items():
            if serious := sorted(keys - set(LOWER_BOUND)):
                left_out.setdefault(name, "; ".join(EXPLAINED.get(key, key) for key in serious))
        after = {name: _mean(rows, metric, attack) for name, rows in attacked.items() if name not in left_out}
        rho, ends = rank_correlation([increase[name] for name in after], list(after.values()))
        lower = tuple(name for name in after if warnings[name])
        predicted.append(
            Prediction(attack, tuple(shared), metric, tuple(after), left_out, lower, rho, ends, common.remark)
        )
    return predicted


def _mean(rows: pl.DataFrame, metric: str, condition: str) -> float:
    return Cube.of(rows).means({metric: MEASURES[metric]}, [(condition, None)])[metric, condition, None]


def _common_rows(runs: Mapping[str, Run], attack: str, samples: Collection[str]) -> dict[str, pl.DataFrame]:
    """Return, by model name, the clean rows and the attack's rows that all runs with this attack measured."""
    of_attack = (pl.col("corruption") == attack) & pl.col("sample").is_in(list(samples)) & MEASURED
    rows = {name: run.attack_rows.filter(of_attack) for name, run in runs.items()}
    attacked = {name: of_run for name, of_run in rows.items() if not of_run.is_empty()}
    return {
        name: pl.concat([runs[name].attack_rows.filter(corruption=CLEAN), of_run])
        for name, of_run in zip(attacked, common_cells(list(attacked.values())), strict=True)
        if not of_run.is_empty()
    }

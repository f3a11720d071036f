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
from ..metrics.cube import AVERAGE, Cube, MeanKey
from ..metrics.measures import ATTACK, MEASURES
from ..metrics.rows import CLEAN, ROW_KEY
from ..run.comparable import MEASURED, common_cells, common_to, named_runs
from ..run.run import Run
from ..run.store import RunFolder
from .estimate import cubes_of, estimate
from .exclusion import exclusions
from .ranking import rank_correlation

Scores = Mapping[MeanKey, float]
"""Numbers of attacks by (measure, attack, severity): the measures of `MEASURES` and of `ATTACK`; "attack_budget" in
grey levels or % of the pixels; "attack_gain", the error minus that under random noise of the same norm;
"attack_seconds" per pair; and the number of pairs with each warning as "warning KEY"."""
WARNING = "warning "
"""Prefix of the measures of warnings."""


def attack_numbers(run: Run) -> list[dict[str, Any]]:
    """Return the numbers of every attack of a run at every severity (`Scores`) as rows of the results frame, starting
    with the controls; the error has an interval."""
    if not run.attacks:
        return []
    (cube,) = cubes_of({"": run.attack_rows}).values()
    known = attack_means(run)
    error = "epe" if any(measure == "epe" for measure, *_ in known) else "rcre"
    scopes = [at for at in cube.conditions if at[0] != CLEAN]
    uncertain = estimate(cube, {error: MEASURES[error]}, scopes).select("condition", "severity", "low", "high")
    ends = {(of, at): {"low": low, "high": high} for of, at, low, high in uncertain.iter_rows()}
    pairs = run.attack_rows.group_by("corruption", "severity").len()
    counts = {(of, at): {"pairs": count} for of, at, count in pairs.iter_rows()}
    return [
        {"measure": measure, "condition": of, "severity": at, "value": value}
        | counts[of, at]
        | (ends.get((of, at), {}) if measure == error else {})
        for (measure, of, at), value in known.items()
    ]


def attack_means(run: Run) -> dict[MeanKey, float]:
    """Return the numbers of every attack (`Scores`)."""
    rows = run.attack_rows
    means = Cube.of(rows).means(MEASURES | ATTACK)
    out: dict[MeanKey, float] = {}
    for name in run.attacks:
        budgets, spent = GREY_LEVELS[attack_spec(name).norm], _seconds(run, name)
        parts = rows.filter(corruption=name).partition_by("severity", as_dict=True)
        for (severity,), part in sorted(parts.items()):
            at = name, severity
            out |= {(m, *at): means[m, *at] for m in (*MEASURES, *ATTACK) if (m, *at) in means}
            out["attack_budget", *at] = budgets[severity - 1]
            out |= {("attack_seconds", *at): spent} if spent is not None else {}
            warnings = Counter(",".join(part["attack_warnings"].drop_nulls()).split(","))
            out |= {(WARNING + key, *at): float(count) for key, count in sorted(warnings.items()) if key}
            out["attack_pairs", *at] = float(part.height)
    return out | beside_others(out)


def _seconds(run: Run, name: str) -> float | None:
    """Return the time per attacked pair, over everything in the run's folder, which is what its manifest counts."""
    spent, rows = run.manifest.seconds.get(f"attack {name}"), RunFolder(run.path).rows(ROW_KEY, name).height
    return spent / rows if spent is not None and rows else None


def strength(scores: Scores, attack: str, severity: int | None) -> float | None:
    """Return the EPE, or the RCRE if there is no ground truth, in pixels."""
    return scores.get(("epe", attack, severity), scores.get(("rcre", attack, severity)))


def beside_others(scores: Scores) -> dict[MeanKey, float]:
    """Return what depends on the numbers of several attacks: the gain over noise, and warnings."""
    out: dict[MeanKey, float] = {}
    cells = [(attack, severity) for measure, attack, severity in scores if measure == "attack_budget"]
    errors = {cell: error for cell in cells if (error := strength(scores, *cell)) is not None}
    untargeted = {cell: error for cell, error in errors.items() if ("attack_way_gone", *cell) not in scores}
    for (attack, severity), error in errors.items():
        spec = attack_spec(attack)
        if attack != spec.control and (spec.control, severity) in errors:
            out["attack_gain", attack, severity] = error - errors[spec.control, severity]
        white_box = spec.kind is not None and spec.kind.needs_gradients and not spec.kind.above
        if not white_box or (attack, severity) not in untargeted:
            continue
        for (other, at), more in untargeted.items():
            beside = attack_spec(other)
            above = "" if beside.kind is None else str(beside.kind.above)
            if more > error and (beside.control, at) == (spec.control, severity) and above:
                out[WARNING + above, attack, severity] = scores["attack_pairs", attack, severity]
    return out


def warnings_of(scores: Scores, attack: str, severity: int | None) -> dict[str, int]:
    """Return the number of pairs with each warning, by its key."""
    found = (key for key in scores if key[0].startswith(WARNING) and key[1:] == (attack, severity))
    return {key[0].removeprefix(WARNING): int(scores[key]) for key in found}


def budget_at_double(scores: Scores, attack: str, clean: float | None) -> float | None:
    """Find the budget in grey levels at which an attack doubles the clean error, interpolated linearly between
    severities.
    """
    if not clean:
        return None
    budget, error = 0.0, clean
    budgets = {at: value for (measure, of, at), value in scores.items() if (measure, of) == ("attack_budget", attack)}
    for severity, after in sorted(budgets.items(), key=lambda item: item[1]):
        reached = scores.get(("epe", attack, severity))
        if reached is None:
            return None
        if reached >= 2 * clean:
            return float(budget + (2 * clean - error) / (reached - error) * (after - budget))
        budget, error = after, reached
    return None


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
    scores = {name: attack_means(run) for name, run in named.items()}
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
            name: {key for level in shared for key in warnings_of(scores[name], attack, level)} for name in attacked
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

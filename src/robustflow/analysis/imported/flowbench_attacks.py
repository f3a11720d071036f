"""Rows of attacks in FlowBench's `metrics_DATASET.json` (see `flowbench`), with what makes each of them doubtful.

Besides model, checkpoint, data set and `metrics`, such an experiment has "attack" (fgsm, bim, pgd, cospgd, pcfa or
weather), "norm" ("inf", or "two": the plain norm of one frame; absent for pcfa, whose bound is a root mean square over
both), "epsilon" in 0..1, rounded to four digits, "iterations", "targeted" and "target". The metrics have `epe`, to the
target where there is one and to the truth otherwise, `epe_ground_truth` with a target, and in some files the changes
that were reached (`l2_delta12`, a root mean square; `l_inf_delta12`). Files per iteration (`..._i3`) are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import DataError
from ...text import plain
from ..audit.findings import Audit, Finding
from .flowbench import FLOWBENCH_DATASETS, is_flowbench
from .json_file import finite_number, read_json_file

STORED_ATTACKS = ("fgsm", "bim", "pgd", "cospgd", "pcfa", "weather")
FLAGS = {
    "beyond_budget": "its frames leave the stated budget",
    "budget_unknown": "the change that was reached is not stored, or not in the norm of the budget",
    "no_budget": "the stored budget is rounded to zero",
    "bim_step": "the step is the whole budget: not BIM",
    "pixels_without_truth": "its loss counts pixels without ground truth, as zero flow",
    "random_weather": "the code that optimises the particles renders those it started from",
    "fgsm_above_iterative": "FGSM is stronger at the same budget: a masked gradient, or badly chosen steps",
    "repeats_differ": "a stored repeat of it differs by more than 5 %",
}
"""What makes a stored row doubtful, by a short name."""

_ROUNDED = 5.1e-5
"""Half a unit of the fourth digit of the stored budget, and float32's rounding of the change."""
_NORMS = {"inf": "linf", "two": "frame"}
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class StoredAttack:
    """One row.

    Attributes:
        model, checkpoint, dataset, attack: as FlowBench calls them.
        norm: "linf", "frame" (the plain norm of one frame), "rms", or "" for weather.
        budget: in the units of frames in 0..1; None for weather.
        iterations: None for a single step.
        target: "none", "zero" or "negative".
        epe: to the truth, px; None where it is not stored.
        to_target: to the target, px; None without one.
        reached: the change in the norm of the budget; None if it is not stored.
        flags: keys of `FLAGS`, sorted.
    """

    model: str
    checkpoint: str
    dataset: str
    attack: str
    norm: str
    budget: float | None
    iterations: int | None
    target: str
    epe: float | None
    to_target: float | None
    reached: float | None
    flags: tuple[str, ...]

    @property
    def setting(self) -> tuple[Any, ...]:
        """Everything but the results."""
        return (
            self.model,
            self.checkpoint,
            self.dataset,
            self.attack,
            self.norm,
            self.budget,
            self.iterations,
            self.target,
        )


def read_stored_attacks(paths: Sequence[Path]) -> list[StoredAttack]:
    """The rows of attacks in files of FlowBench, in their order.

    Raises:
        DataError: a file that cannot be read, is not FlowBench's, or holds what such a file cannot hold.
    """
    rows = []
    for path in paths:
        content = read_json_file(path)
        if not is_flowbench(content):
            raise DataError(f"{path}: not a metrics_DATASET.json of FlowBench, which has a list 'experiments'")
        for index, entry in enumerate(content["experiments"], 1):
            where = f"{path}, experiment {index}"
            if not isinstance(entry, dict):
                raise DataError(f"{where}: not an object")
            if entry.get("attack") in STORED_ATTACKS and not _by_iteration(entry):
                rows.append(_row(entry, where))
    if len(rows) > _MOST_ROWS:
        raise DataError(f"{len(rows)} rows of attacks: more than {_MOST_ROWS}; give fewer files")
    return _compared(rows)


def audit_stored_attacks(rows: Sequence[StoredAttack], audited: str) -> Audit:
    """Which rows are beyond their budget, of those whose change is stored."""
    known = [row for row in rows if row.reached is not None and row.budget is not None]
    findings = [
        Finding(
            check="budget",
            source="FlowBench",
            model=plain(f"{row.model} {row.checkpoint}"),
            metric=row.norm,
            corruption=row.attack,
            given=row.budget,
            recomputed=row.reached,
            tolerance=_ROUNDED,
            message=plain(
                f"{row.model} {row.checkpoint} on {row.dataset}, {row.attack}, target {row.target}: the change is "
                f"{row.reached:.4g} ({row.norm}), the budget {row.budget:.4g}",
                400,
            ),
        )
        for row in known
        if "beyond_budget" in row.flags
    ]
    return Audit(audited=audited, checked={"budget": len(known)} if known else {}, findings=findings)


def _by_iteration(entry: dict[str, Any]) -> bool:
    metrics = entry.get("metrics")
    return isinstance(metrics, dict) and "epe" not in metrics and any(str(name).endswith("_i1") for name in metrics)


def _row(entry: dict[str, Any], where: str) -> StoredAttack:
    metrics, dataset = entry.get("metrics"), entry.get("dataset")
    if not isinstance(metrics, dict) or "epe" not in metrics:
        raise DataError(f"{where}: no 'epe' among its metrics")
    if not isinstance(dataset, str) or not dataset:
        raise DataError(f"{where}: no data set in it")
    names = [entry.get(part) for part in ("model", "checkpoint")]
    if not all(isinstance(name, str | int) and not isinstance(name, bool) and str(name) for name in names):
        raise DataError(f"{where}: no model and checkpoint in it")
    model, checkpoint = (plain(str(name), 40) for name in names)
    attack, targeted, iterations = entry["attack"], entry.get("targeted"), entry.get("iterations")
    target = entry.get("target") if targeted else "none"
    if not isinstance(targeted, bool) or target not in ("none", "zero", "negative"):
        raise DataError(f"{where}: target {plain(repr(target), 40)}; there are zero and negative")
    if iterations is not None and (isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1):
        raise DataError(f"{where}: iterations {plain(repr(iterations), 40)}; expected a whole number from 1")
    norm, budget = "", None
    if attack != "weather":
        norm = "rms" if attack == "pcfa" else _NORMS.get(str(entry.get("norm")), "")
        if not norm:
            raise DataError(f"{where}: norm {plain(repr(entry.get('norm')), 40)}; there are inf and two")
        budget = finite_number(entry.get("epsilon"), f"{where}, epsilon")
    measured = {"linf": "l_inf_delta12", "rms": "l2_delta12"}.get(norm)
    reached = finite_number(metrics[measured], f"{where}, {measured}") if measured in metrics else None
    error = finite_number(metrics["epe"], f"{where}, epe")
    truth = metrics.get("epe_ground_truth") if target != "none" else error
    flags = {
        "beyond_budget": budget is not None and reached is not None and reached > budget + _ROUNDED,
        "budget_unknown": attack != "weather" and reached is None,
        "no_budget": budget == 0,
        "bim_step": attack == "bim",
        "pixels_without_truth": target == "none" and FLOWBENCH_DATASETS.get(dataset) == "kitti2015",
        "random_weather": attack == "weather",
    }
    return StoredAttack(
        model=model,
        checkpoint=checkpoint,
        dataset=plain(dataset, 40),
        attack=attack,
        norm=norm,
        budget=budget,
        iterations=iterations,
        target=target,
        epe=None if truth is None else finite_number(truth, f"{where}, epe_ground_truth"),
        to_target=None if target == "none" else error,
        reached=reached,
        flags=tuple(sorted(flag for flag, holds in flags.items() if holds)),
    )


def _compared(rows: Sequence[StoredAttack]) -> list[StoredAttack]:
    """Add the flags that follow from several rows."""
    repeats: dict[tuple[Any, ...], list[float]] = {}
    single: dict[tuple[Any, ...], float] = {}
    for row in rows:
        score = row.epe if row.target == "none" else row.to_target
        assert score is not None
        repeats.setdefault(row.setting, []).append(score)
        if row.attack == "fgsm" and row.target == "none":
            single[_place(row)] = max(score, single.get(_place(row), 0.0))
    compared = []
    for row in rows:
        flags = set(row.flags)
        scores = repeats[row.setting]
        if max(scores) > 1.05 * min(scores):
            flags.add("repeats_differ")
        iterative = row.attack in ("bim", "pgd", "cospgd") and row.target == "none"
        if iterative and row.epe is not None and single.get(_place(row), 0.0) > row.epe:
            flags.add("fgsm_above_iterative")
        compared.append(replace(row, flags=tuple(sorted(flags))))
    return compared


def _place(row: StoredAttack) -> tuple[Any, ...]:
    return row.model, row.checkpoint, row.dataset, row.norm, row.budget

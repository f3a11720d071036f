"""Read the attack results in FlowBench's `metrics_DATASET.json` (see `flowbench`) and flag questionable rows.

In addition to model, checkpoint, dataset and `metrics`, each experiment has "attack" (fgsm, bim, pgd, cospgd, pcfa or
weather), "norm" ("inf", or "two" for the Euclidean norm of one frame; absent for pcfa, whose bound is a root mean
square over both frames), "epsilon" in 0..1, rounded to four digits, "iterations", "targeted" and "target". The metrics
contain `epe` (the distance to the target if there is one, otherwise to the ground truth), `epe_ground_truth` if there
is a target, and in some files the size of the perturbation (`l2_delta12`, a root mean square; `l_inf_delta12`). Results
of single iterations (`..._i3`) are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import DataError
from ...text import plain
from ..audit.findings import Audit, Finding
from .flowbench import FLOWBENCH_DATASETS, entries, is_flowbench, model_and_metrics
from .json_file import finite_number, read_json_file

STORED_ATTACKS = ("fgsm", "bim", "pgd", "cospgd", "pcfa", "weather")
FLAGS = {
    "beyond_budget": "its frames exceed the stated budget",
    "budget_unknown": "the size of the perturbation is not stored, or is stored in a different norm than the budget",
    "no_budget": "the stored budget is rounded to zero",
    "bim_step": "the step size equals the budget, so this is not BIM",
    "pixels_without_truth": "its loss treats pixels without ground truth as zero flow",
    "random_weather": "the code optimises the particles but renders the initial ones",
    "fgsm_above_iterative": "FGSM is stronger at the same budget, which suggests masked gradients or bad step sizes",
    "repeats_differ": "a repetition of the experiment differs by more than 5 %",
}
"""Short name -> reason why a stored row is questionable."""

_ROUNDED = 5.1e-5
"""Half a unit of the fourth decimal of the stored budget, plus the float32 rounding error of the perturbation."""
_NORMS = {"inf": "linf", "two": "frame"}
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class StoredAttack:
    """One row of FlowBench's attack results.

    Attributes:
        model, checkpoint, dataset, attack: FlowBench's names.
        norm: norm of the budget: "linf", "frame" (the Euclidean norm of one frame), "rms", or "" for weather.
        budget: bound of the norm for frames in 0..1; None for weather.
        iterations: number of iterations; None for a single step.
        target: target of the attack: "none", "zero" or "negative".
        epe: EPE with respect to the ground truth, px; None if not stored.
        to_target: distance to the target, px; None without a target.
        reached: size of the perturbation in the norm of the budget; None if not stored.
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
    def at_budget(self) -> tuple[Any, ...]:
        """The model, the data and the budget, for which attacks are compared."""
        return self.model, self.checkpoint, self.dataset, self.norm, self.budget

    @property
    def setting(self) -> tuple[Any, ...]:
        """All fields except the results."""
        return (*self.at_budget, self.attack, self.iterations, self.target)


def read_stored_attacks(paths: Sequence[Path]) -> list[StoredAttack]:
    """Read the attack results in FlowBench files, in the order of the files.

    Raises:
        DataError: if a file cannot be read, is not a FlowBench file, or contains invalid values.
    """
    rows = []
    for path in paths:
        content = read_json_file(path)
        if not is_flowbench(content):
            raise DataError(f"{path} is not a metrics_DATASET.json of FlowBench, which contains a list 'experiments'")
        attacks = entries(content, path, STORED_ATTACKS)
        rows += [_row(entry, where) for entry, where in attacks if not _has_iterations(entry)]
    if len(rows) > _MOST_ROWS:
        raise DataError(f"{len(rows)} attack rows exceed the limit of {_MOST_ROWS}; give fewer files")
    return _compared(rows)


def audit_stored_attacks(rows: Sequence[StoredAttack], audited: str) -> Audit:
    """Find the rows that exceed their budget, among rows whose perturbation size is stored."""
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
                f"{row.model} {row.checkpoint} on {row.dataset}, {row.attack}, target {row.target}: perturbation "
                f"{row.reached:.4g} ({row.norm}), budget {row.budget:.4g}",
                400,
            ),
        )
        for row in known
        if "beyond_budget" in row.flags
    ]
    return Audit(audited=audited, checked={"budget": len(known)} if known else {}, findings=findings)


def _has_iterations(entry: dict[str, Any]) -> bool:
    metrics = entry.get("metrics")
    return isinstance(metrics, dict) and "epe" not in metrics and any(str(name).endswith("_i1") for name in metrics)


def _row(entry: dict[str, Any], where: str) -> StoredAttack:
    model, checkpoint, metrics = model_and_metrics(entry, where)
    dataset = entry.get("dataset")
    if not isinstance(dataset, str) or not dataset:
        raise DataError(f"{where}: the dataset is missing")
    attack, targeted, iterations = entry["attack"], entry.get("targeted"), entry.get("iterations")
    target = entry.get("target") if targeted else "none"
    if not isinstance(targeted, bool) or target not in ("none", "zero", "negative"):
        raise DataError(f"{where}: target {plain(repr(target), 40)}; expected zero or negative")
    if iterations is not None and (isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1):
        raise DataError(f"{where}: iterations {plain(repr(iterations), 40)}; expected a positive integer")
    norm, budget = "", None
    if attack != "weather":
        norm = "rms" if attack == "pcfa" else _NORMS.get(str(entry.get("norm")), "")
        if not norm:
            raise DataError(f"{where}: norm {plain(repr(entry.get('norm')), 40)}; expected inf or two")
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
    """Add the flags that depend on several rows."""
    repeats: dict[tuple[Any, ...], list[float]] = {}
    single: dict[tuple[Any, ...], float] = {}
    for row in rows:
        score = row.epe if row.target == "none" else row.to_target
        assert score is not None
        repeats.setdefault(row.setting, []).append(score)
        if row.attack == "fgsm" and row.target == "none":
            single[row.at_budget] = max(score, single.get(row.at_budget, 0.0))
    compared = []
    for row in rows:
        flags = set(row.flags)
        scores = repeats[row.setting]
        if max(scores) > 1.05 * min(scores):
            flags.add("repeats_differ")
        iterative = row.attack in ("bim", "pgd", "cospgd") and row.target == "none"
        if iterative and row.epe is not None and single.get(row.at_budget, 0.0) > row.epe:
            flags.add("fgsm_above_iterative")
        compared.append(replace(row, flags=tuple(sorted(flags))))
    return compared

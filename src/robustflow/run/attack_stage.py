"""Attack the samples of a run, in the process that has loaded the model, because attacked frames depend on it.

Attacks that need training are trained once per run, on samples that the run does not measure, and stored in its folder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..attacks import Attack, load_attack
from ..attacks.api import attack_pairs, first_warnings, pair_of_sample
from ..attacks.base import Pattern
from ..attacks.result import Attacked
from ..attacks.trained import Trained
from ..core.errors import UsageError
from ..core.files import digest_of_value
from ..core.rng import Rng, key_of
from ..core.types import Flow, Sample
from ..corruptions.corruption import BGR, VARIANTS
from ..data.benchmarks import Benchmark
from ..data.datasets.split import read_split
from ..metrics.error_maps import epe_map
from ..metrics.rows import CLEAN
from ..models.calls import describe_cell, describe_cells, predict_checked
from ..models.protocols import AnyModel, FlowModel
from .data_files import file_digests
from .manifest import Cell
from .plan import Job, Plan, Unit
from .stages import Seconds, timed
from .store import RunFolder
from .trust import read_array, write_array


def training_keys(attack: Attack, benchmark: Benchmark, seed: int) -> tuple[str, ...]:
    """Return the training samples of an attack, none of which is measured."""
    every, measured = benchmark.dataset.keys(), set(benchmark.keys)
    if attack.trains.isdecimal():
        left = [key for key in every if key not in measured]
        if len(left) < int(attack.trains):
            raise UsageError(
                attack.label,
                f"the attack needs {attack.trains} training samples that are not measured, but only {len(left)} are "
                "available; measure fewer with --limit or --split, or train on fewer",
            )
        return tuple(sorted(left, key=lambda key: (key_of("attack training", seed, key), key))[: int(attack.trains)])
    keys = read_split(attack.trains, every)
    if both := [key for key in keys if key in measured]:
        raise UsageError(
            attack.label,
            f"the attack would be trained on sample '{both[0]}' and {len(both) - 1} more that this run measures; "
            "remove them from the file, or measure different ones with --split",
        )
    return tuple(keys)


def training_digest(attack: Attack, benchmark: Benchmark, seed: int) -> str:
    """Return a digest of an attack's training samples and their files."""
    keys = training_keys(attack, benchmark, seed)
    digests = file_digests({key: benchmark.dataset.files(key) for key in keys})
    return digest_of_value([list(keys), digests])


def trained_attacks(folder: RunFolder, plan: Plan, units: Sequence[Unit]) -> dict[str, Attack]:
    """Return a plan's attacks with the perturbations that the units need, read from the run folder if intact, else
    trained and stored."""
    trained = {name: one.training(plan.model.model) for name, one in plan.attacks.items()}
    learned: dict[str, dict[int, Pattern]] = {}
    for name, severity in sorted({(unit.corruption, level) for unit in units for level in unit.severities}):
        for label, (attack, on) in trained.get(name, {}).items():
            assert isinstance(attack, Trained)
            path, made_of = folder.pattern_path(label, severity), f"{plan.identity.digest()} {label} {severity}"
            pattern = read_array(path, made_of)
            if pattern is None or not attack.fits(pattern) or not np.isfinite(pattern).all():
                pattern = _trained(attack, plan, on, severity)
                path.parent.mkdir(exist_ok=True)
                write_array(path, pattern, made_of)
            learned.setdefault(label, {})[severity] = pattern
    return {name: one.with_learned(learned) for name, one in plan.attacks.items()}


def _trained(attack: Trained, plan: Plan, model: AnyModel, severity: int) -> Pattern:
    seed, benchmark = plan.config.frames.seed, plan.benchmark
    pairs = []
    for key in training_keys(attack, benchmark, seed):
        pair = pair_of_sample(attack, benchmark.dataset.load(key), severity, seed)
        pairs.append((pair, predict_checked(model, pair.frames, key, "clean", 0)))  # type: ignore[arg-type]
    rng = Rng.of(seed, "attack training", attack.name, severity)
    return attack.learn(model, pairs, rng, plan.config.compute.batch_size)


class AttackStage:
    def __init__(self, model: AnyModel, job: Job, seconds: Seconds, on_predict: Callable[[str | None], None]) -> None:
        self.attacks = job.attacks
        self._model = model
        self._seed = job.frames.seed
        self._seconds = seconds
        self._on_predict = on_predict
        self._warnings: frozenset[str] | None = None

    def attack(self, targets: Sequence[tuple[Sample, Flow, Cell]]) -> list[Attacked]:
        """Return the attacked pairs for the cells of one attack, the same as those of `robustflow.attack`."""
        cells = [cell for _, _, cell in targets]
        name = cells[0][1]
        attack = self.attacks[name]
        with timed(self._seconds, "attack"):
            if self._warnings is None:
                self._warnings = self._warnings_of_model(targets[0][0])
            pairs = [(pair_of_sample(attack, sample, cell[2], self._seed), clean) for sample, clean, cell in targets]
            self._on_predict(describe_cells(cells))
            with timed(self._seconds, f"attack {name}"):
                attacked = attack_pairs(attack, self._model, pairs, self._warnings)
            self._on_predict(None)
        return attacked

    @staticmethod
    def columns(attacked: Attacked, sample: Sample) -> dict[str, Any]:
        """Return the columns that appear only in rows of attacks."""
        capped = median = None
        if sample.flow is not None and sample.valid is not None:
            usable = np.isfinite(attacked.flow + attacked.clean_flow).all(axis=-1) & sample.valid
            error = epe_map(attacked.flow, sample.flow)[usable]
            capped = float(np.minimum(error, np.hypot(*sample.shape)).sum())
            median = float(np.median(error)) if error.size else None
        return {
            "attack_linf": attacked.linf,
            "attack_rms": attacked.rms,
            "attack_capped_sum": capped,
            "attack_median": median,
            "attack_way_gone": attacked.way_gone,
            "attack_late_gain": attacked.late_gain,
            "attack_start_spread": attacked.start_spread,
            "attack_evaluations": attacked.evaluations,
            "attack_gradient": attacked.gradient,
            "attack_warnings": ",".join(attacked.warnings) or None,
        }

    def _warnings_of_model(self, sample: Sample) -> frozenset[str]:
        """Return warnings about the model itself, determined by predicting once before the first attack."""
        assert isinstance(self._model, FlowModel)
        self._on_predict(describe_cell(sample.key, CLEAN, 0))
        first, second = sample.frames[:2]
        # `clean` may come from a batched prediction
        flow = predict_checked(self._model, (first, second), sample.key, CLEAN, 0)
        warnings = first_warnings(self._model, (first, second), sample.key, flow)
        self._on_predict(None)
        return warnings


def with_attacks(plan: Plan) -> Plan:
    """Load the attacks of a plan, in the run's variant if available; raise a UsageError if they do not suit it."""
    benchmark, frames, model = plan.benchmark, plan.config.frames, plan.model.model
    if not isinstance(model, FlowModel) or hasattr(model, "predict_clip"):
        raise UsageError("--attacks", "attacks require a two-frame model; omit it")
    attacks = {name: load_attack(name).with_variant(frames.variant) for name in benchmark.attacks}
    if frames.variant not in (*VARIANTS, BGR) and all(one.label == name for name, one in attacks.items()):
        raise UsageError(
            frames.variant, "unknown variant: neither the corruptions nor the attacks of this run support it"
        )
    for one in attacks.values():
        one.check(model)
    sources = {
        name: [one.source, *(training_digest(part, benchmark, frames.seed) for part, _ in one.training(model).values())]
        for name, one in attacks.items()
    }
    used = {name: " ".join(filter(None, digests)) for name, digests in sources.items() if any(digests)}
    return replace(plan, attacks=attacks, attack_sources=used)

"""Compute attack cells in the process that has loaded the model, because attacked frames depend on the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..attacks.api import attack_pairs, first_warnings, pair_of_sample
from ..attacks.own import register_attack
from ..attacks.result import Attacked
from ..benchmarks import Benchmark
from ..corruptions.base import BGR, VARIANTS
from ..errors import UsageError
from ..metrics.error_maps import epe_map
from ..metrics.rows import CLEAN
from ..models.base import AnyModel, FlowModel, describe_cell, describe_cells, predict_checked
from ..runs.cells import Cell
from ..runs.plan import RunOptions
from ..sample import Flow, Sample
from .attack_training import attacks_in_run, training_digest
from .seconds import Seconds, timed


class AttackStage:
    """Attack samples."""

    def __init__(
        self,
        model: AnyModel,
        options: RunOptions,
        seconds: Seconds,
        on_predict: Callable[[str | None], None],
    ) -> None:
        self.names = options.attacks
        for made in options.own_attacks:
            register_attack(made)
        self._attacks = {
            name: one.with_learned(options.learned)
            for name, one in attacks_in_run(options.attacks, options.variant).items()
        }
        self._model = model
        self._options = options
        self._seconds = seconds
        self._on_predict = on_predict
        self._warnings: frozenset[str] | None = None

    def attack(self, targets: Sequence[tuple[Sample, Flow, Cell]]) -> list[Attacked]:
        """Return the attacked pairs for the cells of one attack, as computed by `robustflow.attack` with the run's seed
        and the sample's key.
        """
        cells = [cell for _, _, cell in targets]
        name = cells[0][1]
        with timed(self._seconds, "attack"):
            if self._warnings is None:
                self._warnings = self._warnings_of_model(targets[0][0])
            attack = self._attacks[name]
            pairs = [
                (pair_of_sample(attack, sample, severity, self._options.seed), clean)
                for sample, clean, (_, _, severity) in targets
            ]
            self._on_predict(describe_cells(cells))
            with timed(self._seconds, f"attack {name}"):
                attacked = attack_pairs(attack, self._model, pairs, self._warnings)
            self._on_predict(None)
        return attacked

    def _warnings_of_model(self, sample: Sample) -> frozenset[str]:
        """Return warnings about the model itself, determined by predicting once before the first attack."""
        self._on_predict(describe_cell(sample.key, CLEAN, 0))
        first, second = sample.frames[:2]
        assert isinstance(self._model, FlowModel)
        # `clean` may come from a batched prediction
        flow = predict_checked(self._model, (first, second), sample.key, CLEAN, 0)
        warnings = first_warnings(self._model, (first, second), sample.key, flow)
        self._on_predict(None)
        return warnings


def check_attacks(benchmark: Benchmark, seed: int, variant: str, model: AnyModel) -> dict[str, str]:
    """Check that all requested attacks work with a model."""
    names = benchmark.attacks
    if names and (not isinstance(model, FlowModel) or hasattr(model, "predict_clip")):
        raise UsageError("attacks require a two-frame model; omit --attacks")
    attacks = attacks_in_run(names, variant)
    if variant not in (*VARIANTS, BGR) and all(one.label == name for name, one in attacks.items()):
        raise UsageError(f"unknown variant '{variant}': neither the corruptions nor the attacks of this run support it")
    for one in attacks.values():
        one.check(model)
    sources = {
        name: [one.source, *(training_digest(part, benchmark, seed) for part, _ in one.training(model).values())]
        for name, one in attacks.items()
    }
    return {name: " ".join(filter(None, digests)) for name, digests in sources.items() if any(digests)}


def attack_columns(attacked: Attacked, sample: Sample) -> dict[str, Any]:
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
        "attack_warnings": ",".join(attacked.warnings) or None,
    }

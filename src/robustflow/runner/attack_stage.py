"""A cell that is an attack: its frames follow from the model, so they are made where the model is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..attacks.api import attack_of_sample
from ..attacks.problem import refuse_without_gradient
from ..attacks.registry import ATTACKS
from ..attacks.result import Attacked
from ..corruptions.base import BGR, VARIANTS
from ..errors import UsageError
from ..models.base import AnyModel, FlowModel, describe_cell
from ..runs.plan import Cell, RunOptions
from ..sample import Flow, Sample
from .seconds import Seconds, timed


class AttackStage:
    """Attacks samples.

    Args:
        model: loaded.
        options: of the run.
        seconds: where "attack" is counted.
        on_predict: called with what is being attacked, and with None after it.
    """

    def __init__(
        self,
        model: AnyModel,
        options: RunOptions,
        seconds: Seconds,
        on_predict: Callable[[str | None], None] = lambda what: None,
    ) -> None:
        self.names = options.attacks
        self._model = model
        self._options = options
        self._seconds = seconds
        self._on_predict = on_predict

    def attack(self, sample: Sample, clean: Flow, cell: Cell) -> Attacked:
        """The attacked pair of a sample, as `robustflow.attack` makes it with the run's seed and the sample's key.

        Args:
            sample: with its clean frames and its ground truth.
            clean: flow of the clean frames, float32 (H, W, 2), pixels.
            cell: (sample key, attack, severity).

        Raises:
            ModelError: the attack needs gradients and the model has none.
        """
        _, name, severity = cell
        with timed(self._seconds, "attack"):
            self._on_predict(describe_cell(*cell))
            attacked = attack_of_sample(
                attack_in_run(name, self._options.variant), self._model, sample, clean, severity, self._options.seed
            )
            self._on_predict(None)
        return attacked


def attack_in_run(name: str, variant: str) -> Any:
    """The attack of a run: with the run's variant, if the attack has it."""
    kind = ATTACKS.get(name)
    return kind(variant=variant) if variant in kind.variants else kind()


def check_attacks(names: tuple[str, ...], variant: str, model: AnyModel) -> None:
    """Raise unless a model can be attacked in these ways.

    Raises:
        UsageError: a model of clips or of flows computed elsewhere, or a variant that no attack has.
        ModelError: an attack needs gradients and the model has none.
    """
    if names and (not isinstance(model, FlowModel) or hasattr(model, "predict_clip")):
        raise UsageError("attacks are made on two frames, which this model does not take; leave out --attacks")
    if variant not in (*VARIANTS, BGR) and not any(variant in ATTACKS.get(name).variants for name in names):
        raise UsageError(f"unknown variant '{variant}': neither the corruptions nor the attacks of this run have it")
    for name in names:
        if (attack := attack_in_run(name, variant)).needs_gradients:
            refuse_without_gradient(model, attack.name)


def attack_columns(attacked: Attacked, sample: Sample) -> dict[str, Any]:
    """The columns of a row that only attacks have."""
    capped = None
    if sample.flow is not None and sample.valid is not None:
        error = np.hypot(*np.moveaxis((attacked.flow - sample.flow).astype(np.float64), -1, 0))[sample.valid]
        capped = float(np.minimum(error, np.hypot(*sample.shape)).sum())
    return {
        "attack_linf": attacked.linf,
        "attack_rms": attacked.rms,
        "attack_capped_sum": capped,
        "attack_evaluations": attacked.evaluations,
        "attack_warnings": ",".join(attacked.warnings),
    }

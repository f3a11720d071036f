"""UPFlow's loss, gradients and optimiser steps match those of its authors' code (pack `training_upflow` in the shared
data).
"""

from functools import cache
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.network_with_loss import build_objective  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402
from robustflow.training.unsupervised.methods import TrainingStep  # noqa: E402

from ..shared_data import shared_folder  # noqa: E402
from .pack_steps import Step, TrainingPack, cases_of, steps  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]

CASES = cases_of("upflow")
WEIGHTS = {"census": "photo_loss_census_weight", "distillation": "multi_scale_distillation_weight"}
"""The pack's names of the weights that a case may omit if they are 0."""
_TERM = (2e-6, 1e-5, 1e-4)
"""Relative tolerance of the loss terms in the first, second and later steps."""
GRADIENT, WEIGHT = 1e-3, 5e-5


def pack() -> TrainingPack:
    return TrainingPack.read(shared_folder("parity", "training_upflow"))


def weights_of(case: str) -> dict[str, float]:
    return {name: float(CASES[case]["config"].get(key, 0)) for name, key in WEIGHTS.items()}


def recipe_of(case: str):
    recipe, header = load_recipe("upflow", "unsupervised"), pack().header
    return recipe.changed(crop=header["crop"], objective={**recipe.objective.model_dump(), **weights_of(case)})


def batch_of(header: dict[str, Any]) -> Batch:
    whole = WholeFrames(
        pack().frames(1),
        pack().frames(2),
        torch.tensor(header["starts_xy"], dtype=torch.float32),
        torch.tensor([header["whole"][::-1]] * len(pack().items), dtype=torch.float32),
    )
    first, second = whole.crops(*header["crop"])
    nothing = torch.zeros(len(pack().items), *header["crop"])
    return Batch(first, second, nothing[:, None].expand(-1, 2, -1, -1), nothing, pack().items, whole=whole)


@cache
@torch.enable_grad()  # computed by the first test that needs it
def made(case: str) -> tuple[list[Step], dict[str, torch.Tensor]]:
    """All steps of a case, and the weights after the last one."""
    recipe, batch = recipe_of(case), batch_of(pack().header)
    network = pack().network(recipe)
    module = build_objective(network, recipe)
    count = len(CASES[case]["total"])
    taken = list(steps(network, recipe, lambda _: batch, count, lambda one: module(one, TrainingStep(0, 0, (), 0))))
    return taken, network.weights()


def test_recipe_has_the_weights_of_the_case_with_all_terms():
    pack()
    stated = next(weights for weights in map(weights_of, CASES) if all(weights.values()))
    objective = load_recipe("upflow", "unsupervised").objective
    assert stated == {name: getattr(objective, name) for name in WEIGHTS}


@pytest.mark.parametrize(
    ("case", "number"),
    [(case, number) for case, stated in CASES.items() for number in range(len(stated.get("total", "-")))],
)
def test_step_equals_the_originals(case, number):
    expected, step, tolerance = pack().header["cases"][case], made(case)[0][number], _TERM[min(number, 2)]
    assert step.loss == pytest.approx(expected["total"][number], rel=tolerance)
    for name, value in expected["terms"][number].items():
        assert step.numbers[name].item() == pytest.approx(value or 0.0, rel=tolerance), name
    assert step.norm == pytest.approx(expected["grad_norm"][number], rel=1e-4 if number == 0 else 1e-3)
    assert step.rate == 1e-4


@pytest.mark.parametrize("case", CASES)
def test_gradients_of_the_first_step_equal_the_originals(case):
    arrays, expected = pack().arrays, pack().header["cases"][case]["gradient_norms"]
    gradients = made(case)[0][0].gradients
    assert gradients.keys() == expected.keys()
    for name, norm in expected.items():
        assert gradients[name].norm().item() == pytest.approx(norm, rel=GRADIENT), name
        if (key := f"{case}/gradient/{name}") in arrays:
            assert np.abs(gradients[name].numpy() - arrays[key]).max() <= GRADIENT * np.abs(arrays[key]).max(), name


@pytest.mark.parametrize("case", CASES)
def test_weights_after_the_steps_equal_the_originals(case):
    arrays, (_, weights) = pack().arrays, made(case)
    compared = [key for key in arrays if key.startswith(f"{case}/after/")]
    assert len(compared) == 10
    for key in compared:
        np.testing.assert_allclose(weights[key.rpartition("/")[2]], arrays[key], rtol=0, atol=WEIGHT)

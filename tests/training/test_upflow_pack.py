"""UPFlow's loss, gradients and optimiser steps match those of its authors' code (pack `training_upflow` in the shared
data).
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.models.networks.upflow import BothFlows  # noqa: E402
from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.losses.unsupervised import OneWay  # noqa: E402
from robustflow.training.network_with_loss import build_objective  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402
from robustflow.training.unsupervised import methods as objective  # noqa: E402
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


@dataclass
class Made:
    """Results of a case's training steps; `ways` contains the two flow directions in the first step."""

    steps: list[Step]
    ways: list[OneWay]
    weights: dict[str, torch.Tensor]


def pack() -> TrainingPack:
    return TrainingPack.read(shared_folder("parity", "training_upflow"))


def weights_of(case: str) -> dict[str, float]:
    return {name: float(CASES[case]["config"].get(key, 0)) for name, key in WEIGHTS.items()}


def whole_case() -> str:
    """The first case with all terms."""
    pack()
    return next(case for case in CASES if all(weights_of(case).values()))


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
def made(case: str) -> Made:
    """All steps of a case."""
    recipe, header = recipe_of(case), pack().header
    network = pack().network(recipe)
    module, kept = build_objective(network, recipe), []
    real = objective.upflow_terms

    def watched(ways, settings):
        kept.append(ways)
        return real(ways, settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objective, "upflow_terms", watched)
        taken = []
        for step in steps(
            network,
            recipe,
            lambda number: batch_of(header),
            len(CASES[case]["total"]),
            lambda batch: module(batch, TrainingStep(0, 0, (), 0)),
        ):
            step.numbers = {name: value.item() for name, value in step.numbers.items() if name != "flow"}
            taken.append(step)
    return Made(taken, kept[0], network.weights())


def test_recipe_has_the_weights_of_the_whole_case():
    stated, objective = weights_of(whole_case()), load_recipe("upflow", "unsupervised").objective
    assert stated == {name: getattr(objective, name) for name in WEIGHTS}


@pytest.mark.parametrize(
    ("case", "number"),
    [(case, number) for case, stated in CASES.items() for number in range(len(stated.get("total", "-")))],
)
def test_step_equals_the_originals(case, number):
    expected, step, tolerance = pack().header["cases"][case], made(case).steps[number], _TERM[min(number, 2)]
    assert step.loss == pytest.approx(expected["total"][number], rel=tolerance)
    for name, value in expected["terms"][number].items():
        assert step.numbers[name] == pytest.approx(value or 0.0, rel=tolerance), name
    assert step.norm == pytest.approx(expected["grad_norm"][number], rel=1e-4 if number == 0 else 1e-3)
    assert step.rate == 1e-4


def test_flows_visibility_and_fetched_frames_equal_the_originals():
    arrays, expected, ways = pack().arrays, CASES[whole_case()], made(whole_case()).ways
    for way, name in zip(ways, ("forward", "backward"), strict=True):
        np.testing.assert_allclose(way.flow.detach(), arrays[f"flow_{name}"], atol=1e-4)
        for level, found in enumerate(reversed(way.levels)):
            np.testing.assert_allclose(found.detach(), arrays[f"level{level}_{name}"], atol=1e-4)
        assert (way.seen.numpy() != arrays[f"seen_{name}"]).mean() <= 1e-4
    np.testing.assert_allclose(ways[0].warped[..., ::4, ::4].detach(), arrays["warped1"], atol=1e-4)
    assert [way.seen.mean().item() for way in ways] == pytest.approx(expected["seen_mean"][0], abs=1e-4)


@pytest.mark.parametrize("case", CASES)
def test_gradients_of_the_first_step_equal_the_originals(case):
    arrays, expected, found = pack().arrays, pack().header["cases"][case]["gradient_norms"], made(case)
    gradients = found.steps[0].gradients
    assert gradients.keys() == expected.keys()
    for name, norm in expected.items():
        assert gradients[name].norm().item() == pytest.approx(norm, rel=GRADIENT), name
        if (key := f"{case}/gradient/{name}") in arrays:
            assert np.abs(gradients[name].numpy() - arrays[key]).max() <= GRADIENT * np.abs(arrays[key]).max(), name


@pytest.mark.parametrize("case", CASES)
def test_loss_of_the_originals_flows_has_the_originals_gradient_at_every_pixel(case, monkeypatch):
    """Uses given flows instead of the network's, because smoothness has a kink where two neighbouring vectors are
    equal, and differently rounded flows may be on different sides of it.
    """
    arrays, recipe, expected = pack().arrays, recipe_of(case), pack().header["cases"][case]["terms"][0]
    ways = ("forward", "backward")
    flows = [torch.from_numpy(arrays[f"flow_{way}"]).requires_grad_() for way in ways]
    levels = [[torch.from_numpy(arrays[f"level{level}_{way}"]) for way in ways] for level in (4, 3, 2, 1, 0)]
    network = pack().network(recipe)
    monkeypatch.setattr(network.net, "both", lambda *images: BothFlows(*flows, [(one, two) for one, two in levels]))
    loss, terms = build_objective(network, recipe)(batch_of(pack().header), TrainingStep(0, 0, (), 0))
    loss.backward()
    for name, value in expected.items():
        assert terms[name].item() == pytest.approx(value or 0.0, rel=_TERM[0]), name
    for flow, way in zip(flows, ways, strict=True):
        wanted = arrays[f"{case}/gradient/flow_{way}"]
        np.testing.assert_allclose(flow.grad[..., ::2, ::2], wanted, rtol=0, atol=GRADIENT * np.abs(wanted).max())


@pytest.mark.parametrize("case", CASES)
def test_weights_after_the_steps_equal_the_originals(case):
    arrays, weights = pack().arrays, made(case).weights
    for key in [key for key in arrays if key.startswith(f"{case}/after/")]:
        np.testing.assert_allclose(weights[key.rpartition("/")[2]], arrays[key], rtol=0, atol=WEIGHT)

"""BrightFlow's loss, corrector and learning rates match those of the original code. The outputs of the networks are
replaced with flows and colour offsets from the pack `training_brightflow`."""

import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

import torch.nn.functional as F  # noqa: E402
from torch import Tensor  # noqa: E402

from robustflow.models.networks.loaders import NETWORKS  # noqa: E402
from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.optimization import SCHEDULES  # noqa: E402
from robustflow.training.recipe import Recipe, load_recipe  # noqa: E402
from robustflow.training.trained_network import Corrector  # noqa: E402
from robustflow.training.unsupervised import brightflow as objective  # noqa: E402
from robustflow.training.unsupervised.methods import TrainingStep  # noqa: E402

from ..parity.weight_rule import digest, weights  # noqa: E402
from .pack_steps import TrainingPack, cases_of  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]

PACK = "parity/training_brightflow"
CASES = cases_of("brightflow")
RECIPES = {"kitti": "unsupervised"}
"""The stage of each case that neither states its stage nor is named after it."""
LOSS, GRADIENT = 1e-5, 1e-2
"""Relative tolerances; a gradient's is relative to the gradient's largest value."""
INPUTS = {"flow": "flow", "stud": "student", "correc_aug": "offsets_augmented"}
KEYS = {name: key for key, name in INPUTS.items()}
TERMS = {"photometric": "photo", "smoothness": "smooth", "self_supervision": "self", "corrector": "correc"}


@dataclass
class Given:
    """The pack and the inputs whose gradients are compared."""

    cases: dict[str, Any]
    arrays: dict[str, np.ndarray]
    batch: Batch
    inputs: dict[str, Tensor] = field(default_factory=dict)

    def enlarged(self, name: str) -> Tensor:
        """A grid at the crop's size, indexed by (pair, direction, ...)."""
        grid = self.inputs.setdefault(name, torch.from_numpy(self.arrays[name]).requires_grad_(True))
        fine = F.interpolate(grid.flatten(0, -4), tuple(self.cases["crop"]), mode="bilinear", align_corners=True)
        return fine.unflatten(0, grid.shape[:-3])


@cache
def read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], Batch]:
    pack = TrainingPack.read(folder)
    cases, count = pack.header, len(pack.items)
    corners = torch.tensor(cases["corners_xy"], dtype=torch.float32)
    height, width = cases["whole"]
    kinds = []
    for augmented in (False, True):
        buffers = torch.zeros(2, count, 3, *cases["buffer"])  # frame, pair
        for frame in (0, 1):
            values = pack.frames(frame + 1).double()
            buffers[frame, ..., :height, :width] = (0.8 * values + 20).floor() if augmented else values
        kinds.append(WholeFrames(buffers[0], buffers[1], corners, torch.tensor([[width, height]] * count).float()))
    plain, whole = kinds
    first, second = whole.crops(*cases["crop"])
    nothing = torch.zeros(count, *cases["crop"])
    students = (torch.full_like(first, 7.0), torch.full_like(second, 9.0))  # distinct from other frames
    truth = nothing[:, None].expand(-1, 2, -1, -1)
    batch = Batch(first, second, truth, nothing, pack.items, None, None, whole, plain)
    return cases, pack.arrays, Batch(**{**vars(batch), "changed": students})


class Answers:
    """A network and a corrector that return the pack's arrays for the given frames."""

    def __init__(self, given: Given) -> None:
        self.given = given
        self.convention = NETWORKS["brightflow"].convention
        self.net = self
        self.asked: list[tuple[str, int, Tensor]] = []
        batch = given.batch
        assert batch.plain is not None
        self._crops = {
            "augmented": (batch.image1, batch.image2),
            "plain": batch.plain.crops(*given.cases["crop"]),
            "student": batch.changed,
        }

    def _which(self, image: Tensor) -> tuple[str, int]:
        """The kind of an image and the index of its frame."""
        for kind, crops in self._crops.items():
            for frame in (0, 1):
                if torch.allclose((image + 1) * 127.5, crops[frame], atol=1e-3):
                    return kind, frame
        raise AssertionError("frames that do not belong to the batch")

    def both(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        kind, frame = self._which(image1)
        assert (frame, self._which(image2)) == (0, (kind, 1))
        if kind == "plain":
            assert not torch.is_grad_enabled()
            teacher = self.given.enlarged("teacher")
            return [teacher[:, 0]], [teacher[:, 1]]
        flows = self.given.enlarged("flow" if kind == "augmented" else "student")  # last iteration first
        there, back = (list(flows[:, way].flip(1).unbind(1)) for way in (0, 1))
        return there, back

    def corrector(self, images: Tensor) -> Tensor:
        kind, frame = self._which(images[:, :3])
        self.asked.append((kind, frame, images))
        return self.given.enlarged("offsets" if kind == "plain" else "offsets_augmented")[:, frame]


@dataclass
class Outcome:
    terms: dict[str, float]
    gradients: dict[str, Tensor]
    asked: list[tuple[str, int, Tensor]]


def recipe_of(case: str) -> Recipe:
    return load_recipe("brightflow", CASES[case].get("stage", RECIPES.get(case, case)))


def step(given: Given, case: str, number: int, gradients: bool = False) -> Outcome:
    torch.set_num_threads(1)
    given.inputs.clear()
    recipe = recipe_of(case)
    answers: Any = Answers(given)
    module = objective.Brightflow(answers, recipe, recipe.objective)
    with torch.set_grad_enabled(gradients):
        loss, numbers = module(given.batch, TrainingStep(0, number, (0, 1), number / recipe.steps))
    if gradients:
        loss.backward()
    terms = {name: numbers[key].item() if key in numbers else 0.0 for key, name in TERMS.items()}
    reached = {name: value.grad for name, value in given.inputs.items() if value.grad is not None}
    return Outcome({**terms, "loss_total": loss.item()}, reached, answers.asked)


EACH_CASE = pytest.mark.parametrize("case", CASES)


@pytest.fixture
def given(shared) -> Given:
    return Given(*read(shared(PACK)))


@EACH_CASE
def test_recipe_has_the_settings_of_the_case(given, case):
    expected, settings = given.cases["cases"][case], recipe_of(case).objective
    assert (settings.occlusion, settings.second_order) == (expected["occlusion"], expected["smoothness_order"] == 2)
    assert (settings.smooth, settings.census) == (expected["smoothness_weight"], expected["census_weight"])


@pytest.mark.parametrize(
    ("case", "number"), [(case, int(number)) for case, stated in CASES.items() for number in stated.get("steps", "0")]
)
def test_terms_and_gradients_of_a_step_equal_the_originals(given, case, number):
    expected, found = given.cases["cases"][case]["steps"][str(number)], step(given, case, number, gradients=True)
    for name, value in found.terms.items():
        assert value == pytest.approx(expected[name], rel=LOSS), name
    norms = {INPUTS[name]: norm for name, norm in expected["gradient_norms"].items() if norm is not None}
    assert found.gradients.keys() == norms.keys()
    for name, gradient in found.gradients.items():
        assert gradient.norm().item() == pytest.approx(norms[name], rel=GRADIENT)
        wanted = torch.from_numpy(given.arrays[f"{case}/{number}/gradient/{KEYS[name]}"])
        assert (gradient - wanted).abs().max() <= GRADIENT * wanted.abs().max()


def test_corrector_gives_the_originals_offsets_and_gradients(given, shared):
    expected, made = given.cases["corrector"], weights(shared(PACK) / "keys.json")
    assert digest(made) == given.cases["digest"]
    corrector = Corrector()
    corrector.load_state_dict({key: torch.from_numpy(value) for key, value in made.items()}, strict=True)
    rule = r"first (\d+)x(\d+) px of the corrector input of case (\w+), step (\d+)"
    height, width, case, number = re.fullmatch(rule, expected["input"]).groups()
    images = [image[..., : int(height), : int(width)] for _, _, image in step(given, case, int(number)).asked[:2]]
    offsets = corrector(torch.stack(images, 1).flatten(0, 1)).unflatten(0, (-1, 2))
    loss = (offsets - torch.linspace(-0.3, 0.3, int(width))).abs().mean()
    loss.backward()
    np.testing.assert_allclose(offsets[..., ::4, ::4].detach(), given.arrays["corrector/offsets"], atol=1e-5)
    assert loss.item() == pytest.approx(expected["loss"], rel=LOSS)
    gradients = {name: value.grad for name, value in corrector.named_parameters()}
    assert gradients.keys() == expected["gradient_norms"].keys()
    for name, norm in expected["gradient_norms"].items():
        assert gradients[name].norm().item() == pytest.approx(norm, rel=GRADIENT, abs=1e-6), name
    compared = [key for key in given.arrays if key.startswith("corrector/gradient/")]
    assert len(compared) == 4
    for key in compared:
        wanted = given.arrays[key]
        off = np.abs(gradients[key.removeprefix("corrector/gradient/")].numpy() - wanted).max()
        assert off <= GRADIENT * np.abs(wanted).max()


def test_learning_rates_equal_the_originals(given):
    recipe = load_recipe("brightflow", "unsupervised")
    assert recipe.updates == recipe.steps
    for update, rate in given.cases["rates"]:
        assert SCHEDULES[recipe.schedule](update, recipe.steps, recipe.learning_rate) == pytest.approx(rate, rel=1e-9)

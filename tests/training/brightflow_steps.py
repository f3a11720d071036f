"""Training steps of BrightFlow. The networks' outputs are replaced with flows and colour offsets from the pack
`training_brightflow`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

import torch.nn.functional as F  # noqa: E402
from torch import Tensor  # noqa: E402

from robustflow.models.networks.table import NETWORKS  # noqa: E402
from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.recipe import Recipe, load_recipe  # noqa: E402
from robustflow.training.unsupervised import brightflow as objective  # noqa: E402
from robustflow.training.unsupervised.methods import TrainingStep  # noqa: E402

from .pack_steps import TrainingPack, cases_of  # noqa: E402

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
    """The results of one training step."""

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

"""BrightFlow's loss, corrector and rates against the original's numbers, with the flows and colour offsets of the pack
`training_brightflow` in place of the networks' outputs; and mistakes that these numbers must reject."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

import torch.nn.functional as F  # noqa: E402
from torch import Tensor  # noqa: E402

from robustflow.images.io import read_image  # noqa: E402
from robustflow.models.networks.table import NETWORKS  # noqa: E402
from robustflow.training.corrector import Corrector  # noqa: E402
from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.losses import brightflow as losses  # noqa: E402
from robustflow.training.losses import dilated_warp, photometric, smoothness  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402
from robustflow.training.schedules import SCHEDULES  # noqa: E402
from robustflow.training.unsupervised import brightflow as objective  # noqa: E402
from robustflow.training.unsupervised.objective import TrainingStep  # noqa: E402

from ..parity.weight_rule import digest, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]

PACK = "parity/training_brightflow"
RECIPES = {"kitti": "unsupervised", "sintel": "sintel"}
STEPS = 75_000
LOSS, GRADIENT = 1e-5, 1e-2
"""Relative; of a gradient, of its largest."""
INPUTS = {"flow": "flow", "stud": "student", "correc_aug": "offsets_augmented"}
KEYS = {name: key for key, name in INPUTS.items()}
TERMS = {"photometric": "photo", "smoothness": "smooth", "self_supervision": "self", "corrector": "correc"}


@dataclass
class Given:
    """The pack, and the inputs whose gradients are compared."""

    cases: dict[str, Any]
    arrays: dict[str, np.ndarray]
    batch: Batch
    inputs: dict[str, Tensor] = field(default_factory=dict)

    def enlarged(self, name: str) -> Tensor:
        """(pair, direction, ...) of a grid at the crop's size."""
        grid = self.inputs.setdefault(name, torch.from_numpy(self.arrays[name]).requires_grad_(True))
        fine = F.interpolate(grid.flatten(0, -4), tuple(self.cases["crop"]), mode="bilinear", align_corners=True)
        return fine.unflatten(0, grid.shape[:-3])


@cache
def read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], Batch]:
    cases = json.loads((folder / "cases.json").read_text())
    with np.load(folder / "expected.npz") as file:
        arrays = dict(file)
    corners = torch.tensor(cases["corners_xy"], dtype=torch.float32)
    height, width = cases["whole"]
    kinds = []
    for augmented in (False, True):
        buffers = torch.zeros(2, 2, 3, *cases["buffer"])  # frame, pair
        for frame in (0, 1):
            for pair in (0, 1):
                values = torch.from_numpy(read_image(folder / f"item{pair}_{frame + 1}.png")).permute(2, 0, 1).double()
                buffers[frame, pair, :, :height, :width] = (0.8 * values + 20).floor() if augmented else values
        kinds.append(WholeFrames(buffers[0], buffers[1], corners, torch.tensor([[width, height]] * 2).float()))
    plain, whole = kinds
    first, second = whole.crops(*cases["crop"])
    nothing = torch.zeros(2, *cases["crop"])
    students = (torch.full_like(first, 7.0), torch.full_like(second, 9.0))  # to distinguish it from other frames
    batch = Batch(first, second, nothing[:, None].expand(-1, 2, -1, -1), nothing, ("0", "1"), None, None, whole, plain)
    return cases, arrays, Batch(**{**vars(batch), "changed": students})


@pytest.fixture
def given(shared) -> Given:
    return Given(*read(shared(PACK)))


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
        """The kind of an image, and which frame it is."""
        for kind, crops in self._crops.items():
            for frame in (0, 1):
                if torch.allclose((image + 1) * 127.5, crops[frame], atol=1e-3):
                    return kind, frame
        raise AssertionError("frames that are none of the batch's")

    def both(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        kind, frame = self._which(image1)
        assert (frame, self._which(image2)) == (0, (kind, 1))
        if kind == "plain":
            assert not torch.is_grad_enabled()
            teacher = self.given.enlarged("teacher")
            return [teacher[:, 0]], [teacher[:, 1]]
        flows = self.given.enlarged("flow" if kind == "augmented" else "student")  # the last iteration first
        there, back = (list(flows[:, way].flip(1).unbind(1)) for way in (0, 1))
        return there, back

    def corrector(self, images: Tensor) -> Tensor:
        kind, frame = self._which(images[:, :3])
        self.asked.append((kind, frame, images))
        return self.given.enlarged("offsets" if kind == "plain" else "offsets_augmented")[:, frame]


@dataclass
class Outcome:
    """What one step gave."""

    terms: dict[str, float]
    gradients: dict[str, Tensor]
    asked: list[tuple[str, int, Tensor]]


def step(given: Given, case: str, number: int, gradients: bool = False) -> Outcome:
    torch.set_num_threads(1)
    given.inputs.clear()
    recipe = load_recipe("brightflow", RECIPES[case])
    answers: Any = Answers(given)
    module = objective.Brightflow(answers, recipe, recipe.objective)
    with torch.set_grad_enabled(gradients):
        loss, numbers = module(given.batch, TrainingStep(0, number, (0, 1), number / STEPS))
    if gradients:
        loss.backward()
    terms = {name: numbers[key].item() if key in numbers else 0.0 for key, name in TERMS.items()}
    reached = {name: value.grad for name, value in given.inputs.items() if value.grad is not None}
    return Outcome({**terms, "loss_total": loss.item()}, reached, answers.asked)


@pytest.mark.parametrize("case", RECIPES)
def test_recipe_has_the_settings_of_the_case(given, case):
    expected, settings = given.cases["cases"][case], load_recipe("brightflow", RECIPES[case]).objective
    assert (settings.occlusion, settings.second_order) == (expected["occlusion"], expected["smoothness_order"] == 2)
    assert (settings.smooth, settings.census) == (expected["smoothness_weight"], expected["census_weight"])


@pytest.mark.parametrize("number", [0, 22000, 26000, 33750, 60000])
@pytest.mark.parametrize("case", RECIPES)
def test_terms_and_gradients_of_a_step_are_the_originals(given, case, number):
    expected, found = given.cases["cases"][case]["steps"][str(number)], step(given, case, number, gradients=True)
    for name, value in found.terms.items():
        assert value == pytest.approx(expected[name], rel=LOSS), name
    norms = {INPUTS[name]: norm for name, norm in expected["gradient_norms"].items() if norm is not None}
    assert found.gradients.keys() == norms.keys()
    for name, gradient in found.gradients.items():
        assert gradient.norm().item() == pytest.approx(norms[name], rel=GRADIENT)
        wanted = torch.from_numpy(given.arrays[f"{case}/{number}/gradient/{KEYS[name]}"])
        assert (gradient - wanted).abs().max() <= GRADIENT * wanted.abs().max()


def _alone(given: Given, pair: int) -> Given:
    """The pack with one pair of its batch."""

    def only(value: Any) -> Any:
        if isinstance(value, WholeFrames):
            return WholeFrames(*map(only, vars(value).values()))
        return tuple(map(only, value)) if isinstance(value, tuple) else value if value is None else value[pair:][:1]

    arrays = {name: only(given.arrays[name]) for name in ("flow", "student", "teacher", "offsets", "offsets_augmented")}
    return Given(given.cases, arrays, Batch(**{name: only(value) for name, value in vars(given.batch).items()}))


@pytest.mark.parametrize("case", RECIPES)
def test_loss_of_a_batch_is_the_mean_of_its_pairs(given, case):
    """So that a training of several processes, each with a share of the batch, makes the same updates; below the limit
    of the self-supervision, which each process applies to the mean of its share."""
    arrays = {**given.arrays, **{name: given.arrays[name] / 4 for name in ("student", "teacher")}}
    whole = Given(given.cases, arrays, given.batch)
    together, *singly = (step(one, case, 60000, gradients=True) for one in (whole, _alone(whole, 0), _alone(whole, 1)))
    assert all(0 < one.terms["self"] < objective.FARTHEST for one in singly)
    for name, value in together.terms.items():
        assert value == pytest.approx(sum(one.terms[name] for one in singly) / 2, rel=1e-6), name
    for name, gradient in together.gradients.items():
        shares = torch.cat([one.gradients[name] for one in singly]) / 2
        assert (gradient - shares).abs().max() <= 1e-4 * gradient.abs().max(), name


@pytest.mark.parametrize("case", RECIPES)
def test_masks_kept_offsets_and_corrector_input_are_the_originals(given, case, monkeypatch):
    expected, visible, kept = given.cases["cases"][case], [], []
    _spy(monkeypatch, "visibility", visible)
    _spy(monkeypatch, "kept_offsets", kept)
    found = step(given, case, 26000)
    ways = [torch.stack(visible[:3], 1), torch.stack(visible[3:], 1)]  # pair, iteration
    means = torch.stack(ways, 1).mean((0, 1, 3, 4, 5)).flip(0).tolist()
    assert means == pytest.approx(expected["mean_visible"], rel=1e-5)
    last = torch.stack(ways, 1)[:, :, -1, :, ::2, ::2].numpy()
    assert (np.abs(last - given.arrays[f"{case}/visible_last"]) > 1e-4).mean() <= 1e-4
    offsets = torch.stack(kept, 1)
    wanted = np.unpackbits(given.arrays[f"{case}/kept"]).reshape(offsets.shape)
    assert 0.2 < wanted.mean() < 0.4
    assert (offsets.numpy() != wanted).mean() <= 1e-4
    assert [(kind, frame) for kind, frame, _ in found.asked] == [(k, f) for k in ("augmented", "plain") for f in (0, 1)]
    images = torch.stack([images[..., ::8, ::8] for _, _, images in found.asked[:2]], 1).numpy()
    np.testing.assert_allclose(images, given.arrays[f"{case}/corrector_input"], atol=1e-4)


def _spy(monkeypatch: pytest.MonkeyPatch, name: str, seen: list[Tensor]) -> None:
    real = getattr(objective, name)

    def watched(*args: Any) -> Tensor:
        seen.append(real(*args).detach())
        return seen[-1]

    monkeypatch.setattr(objective, name, watched)


@pytest.fixture
def corrector(shared) -> Corrector:
    keys = shared(PACK) / "keys.json"
    made = weights(keys)
    assert digest(made) == json.loads((keys.parent / "cases.json").read_text())["digest"]
    network = Corrector()
    network.load_state_dict({key: torch.from_numpy(value) for key, value in made.items()}, strict=True)
    return network


def _corrected(network: Corrector, given: Given) -> tuple[Tensor, Tensor, Tensor]:
    """The corrector's images, its offsets for them, and its loss."""
    images = [image[..., :128, :136] for _, _, image in step(given, "kitti", 26000).asked[:2]]
    together = torch.stack(images, 1).flatten(0, 1)
    offsets = network(together).unflatten(0, (2, 2))
    return together, offsets, (offsets - torch.linspace(-0.3, 0.3, 136)).abs().mean()


def test_corrector_gives_the_originals_offsets_and_gradients(given, corrector):
    _, offsets, loss = _corrected(corrector, given)
    loss.backward()
    expected = given.cases["corrector"]
    np.testing.assert_allclose(offsets[..., ::4, ::4].detach(), given.arrays["corrector/offsets"], atol=1e-5)
    assert loss.item() == pytest.approx(expected["loss"], rel=LOSS)
    gradients = {name: value.grad for name, value in corrector.named_parameters()}
    assert gradients.keys() == expected["gradient_norms"].keys()
    for name, norm in expected["gradient_norms"].items():
        assert gradients[name].norm().item() == pytest.approx(norm, rel=GRADIENT, abs=1e-6), name
    for key in [key for key in given.arrays if key.startswith("corrector/gradient/")]:
        wanted = given.arrays[key]
        off = np.abs(gradients[key.removeprefix("corrector/gradient/")].numpy() - wanted).max()
        assert off <= GRADIENT * np.abs(wanted).max()


def test_corrector_with_an_activation_after_its_encoder_is_rejected(given, corrector):
    _, right, _ = _corrected(corrector, given)
    corrector.conv2.register_forward_hook(lambda module, inputs, output: torch.relu(output))
    _, wrong, _ = _corrected(corrector, given)
    assert (wrong - right).abs().max() > 0.01


def test_rates_are_the_originals(given):
    recipe = load_recipe("brightflow", "unsupervised")
    assert recipe.updates == recipe.steps == STEPS
    for update, rate in given.cases["rates"]:
        assert SCHEDULES[recipe.schedule](update, STEPS, recipe.learning_rate) == pytest.approx(rate, rel=1e-9)


def _unit_range(patch, given):
    real = smoothness.robust_smoothness
    patch(objective, "robust_smoothness", lambda flow, image, *rest: real(flow, image / 255, *rest))


def _half_smoothness(patch, given):
    real = smoothness.robust_smoothness
    patch(objective, "robust_smoothness", lambda *args: real(*args) / 2)


def _usual_grey(patch, given):
    patch(losses, "LUMA", photometric.LUMA)


def _last_mask(patch, given):
    real = objective._census
    patch(
        objective,
        "_census",
        lambda image, source, way, place: real(image, source, way._replace(visible=way.visible[-1:] * 3), place),
    )


def _one_quotient(patch, given):
    patch(losses, "masked_mean", lambda values, mask: (values * mask).sum() / mask.sum())


def _all_visible(patch, given):
    patch(objective, "visibility", lambda flow, *rest: torch.ones_like(flow[:, :1]))


def _hard_coverage(patch, given):
    real = losses.coverage
    patch(losses, "coverage", lambda flow, *values: (real(flow, *values) >= 0.2).float())


def _crop_is_all(patch, given):
    patch(losses, "leaves", lambda flow: torch.zeros_like(flow[:, :1]))


def _augmented_compared(patch, given):
    patch(given, "batch", Batch(**{**vars(given.batch), "plain": given.batch.whole}))


def _target_corrected(patch, given):
    def to_the_target(self, frame, frames, ways, place):
        flow, visible = ways[frame].flows[-1].detach(), ways[frame].visible[-1]
        warped = objective._warped(frames.whole[1 - frame], flow, place)
        offsets = self._offsets(frame, frames, ways, place) * visible
        return losses.correction_loss(frames.crops[frame] + offsets, warped, visible)

    patch(objective.Brightflow, "_correction", to_the_target)


def _half_offsets(patch, given):
    real = objective.Brightflow._offsets
    patch(objective.Brightflow, "_offsets", lambda *args: real(*args) / 2)


def _mean_of_colours(patch, given):
    patch(objective, "correction_loss", lambda *args: losses.correction_loss(*args) / 3)


def _clamped_correction(patch, given):
    patch(objective, "with_offsets", lambda *args: losses.with_offsets(*args).clamp(0, 255))


def _all_kept(patch, given):
    patch(objective, "kept_offsets", lambda target, warped, corrected, flow: torch.ones_like(flow[:, :1]))


def _kept_at_the_target(patch, given):
    patch(
        objective,
        "kept_offsets",
        lambda target, warped, corrected, flow: (
            (target - corrected).abs().mean(1, True) < (target - warped).abs().mean(1, True)
        ).float(),
    )


def _edge_pixels_not_black(patch, given):
    patch(dilated_warp, "inside_frame", lambda flow, *place: torch.ones_like(flow[:, :1]))


def _teacher_sees_augmented(patch, given):
    real = objective.Brightflow._students

    def students(self, batch, plain):
        return real(self, batch, plain._replace(crops=(batch.image1, batch.image2)))

    patch(objective.Brightflow, "_students", students)


def _half_self(patch, given):
    patch(objective, "self_supervised", lambda *args: losses.self_supervised(*args) / 2)


def _clamped_differences(patch, given):
    real = losses.charbonnier
    patch(losses, "charbonnier", lambda differences: real(differences).clamp(0, 10))


def _low_limit(patch, given):
    patch(objective, "FARTHEST", 50.0)


MISTAKES = [
    (_unit_range, "kitti", 0, "smooth", 5.0),
    (_unit_range, "sintel", 0, "smooth", 5.0),
    (_half_smoothness, "kitti", 0, "smooth", 0.4),
    (_usual_grey, "kitti", 0, "photo", 5e-4),
    (_last_mask, "kitti", 0, "photo", 3e-4),
    (_last_mask, "sintel", 0, "photo", 3e-5),
    (_one_quotient, "kitti", 0, "photo", 4e-4),
    (_one_quotient, "sintel", 0, "photo", 1.5e-5),
    (_all_visible, "kitti", 0, "photo", 2e-3),
    (_hard_coverage, "sintel", 0, "photo", 2e-5),
    (_crop_is_all, "kitti", 0, "photo", 2e-5),
    (_augmented_compared, "kitti", 0, "photo", 1e-3),
    (_augmented_compared, "kitti", 0, "smooth", 0.2),
    (_target_corrected, "kitti", 22000, "correc", 0.02),
    (_half_offsets, "kitti", 22000, "correc", 0.1),
    (_mean_of_colours, "kitti", 22000, "correc", 0.6),
    (_clamped_correction, "kitti", 22000, "correc", 1e-3),
    (_half_offsets, "sintel", 26000, "photo", 1e-3),
    (_all_kept, "kitti", 26000, "photo", 1e-3),
    (_kept_at_the_target, "kitti", 26000, "photo", 1e-3),
    (_edge_pixels_not_black, "kitti", 0, "photo", LOSS),
    (_teacher_sees_augmented, "kitti", 33750, "self", 0.01),
    (_half_self, "kitti", 33750, "self", 0.4),
    (_clamped_differences, "kitti", 33750, "self", 0.1),
    (_low_limit, "kitti", 33750, "loss_total", 0.1),
]


@pytest.mark.parametrize(
    ("mistake", "case", "number", "term", "least"),
    MISTAKES,
    ids=[f"{mistake.__name__.strip('_')}-{case}-{term}" for mistake, case, _, term, _ in MISTAKES],
)
def test_mistake_moves_the_term_beyond_its_tolerance(given, monkeypatch, mistake, case, number, term, least):
    mistake(monkeypatch.setattr, given)
    expected = given.cases["cases"][case]["steps"][str(number)][term]
    off = abs(step(given, case, number).terms[term] / expected - 1)
    assert off > least >= LOSS

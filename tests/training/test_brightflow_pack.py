"""BrightFlow's loss, corrector and learning rates match those of the original code, and the comparison detects
deliberate mistakes in the loss."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from torch import Tensor  # noqa: E402

from robustflow.training.data.loader import Batch, WholeFrames  # noqa: E402
from robustflow.training.losses import terms  # noqa: E402
from robustflow.training.losses import unsupervised as losses  # noqa: E402
from robustflow.training.networks import Corrector  # noqa: E402
from robustflow.training.optimization import SCHEDULES  # noqa: E402
from robustflow.training.recipe import load_recipe  # noqa: E402
from robustflow.training.unsupervised import brightflow as objective  # noqa: E402

from ..parity.weight_rule import digest, weights  # noqa: E402
from .brightflow_steps import CASES, GRADIENT, INPUTS, KEYS, LOSS, PACK, Given, read, recipe_of, step  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]


EACH_CASE = pytest.mark.parametrize("case", CASES)
PHASES = {
    "start": lambda stated: True,
    "corrector learns": lambda stated: stated["correc"] > 0,
    "offsets used": lambda stated: "kept" in stated,
    "student learns": lambda stated: stated["self_weight"] > 0,
}
"""Which steps belong to a phase of the training."""


def first_step(case: str, phase: str) -> int:
    """The first step of a phase."""
    return next(int(number) for number, stated in CASES[case]["steps"].items() if PHASES[phase](stated))


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


def _alone(given: Given, pair: int) -> Given:
    """The pack, reduced to one pair of its batch."""

    def only(value: Any) -> Any:
        if isinstance(value, WholeFrames):
            return WholeFrames(*map(only, vars(value).values()))
        return tuple(map(only, value)) if isinstance(value, tuple) else value if value is None else value[pair:][:1]

    arrays = {name: only(given.arrays[name]) for name in ("flow", "student", "teacher", "offsets", "offsets_augmented")}
    return Given(given.cases, arrays, Batch(**{name: only(value) for name, value in vars(given.batch).items()}))


@EACH_CASE
def test_loss_of_a_batch_is_the_mean_of_its_pairs(given, case):
    """Training in several processes, each with a share of the batch, makes the same updates as in one process. This is
    only true until the self-supervision limit takes effect, because each process applies the limit to the mean of its
    share.
    """
    arrays = {**given.arrays, **{name: given.arrays[name] / 4 for name in ("student", "teacher")}}
    whole = Given(given.cases, arrays, given.batch)
    number, count = max(map(int, CASES[case]["steps"])), len(given.batch.names)
    shares = [_alone(whole, pair) for pair in range(count)]
    together, *singly = (step(one, case, number, gradients=True) for one in (whole, *shares))
    assert all(0 < one.terms["self"] < objective.FARTHEST for one in singly)
    for name, value in together.terms.items():
        assert value == pytest.approx(sum(one.terms[name] for one in singly) / count, rel=1e-6), name
    for name, gradient in together.gradients.items():
        mean = torch.cat([one.gradients[name] for one in singly]) / count
        assert (gradient - mean).abs().max() <= 1e-4 * gradient.abs().max(), name


@EACH_CASE
def test_masks_kept_offsets_and_corrector_input_equal_the_originals(given, case, monkeypatch):
    expected, visible, kept = given.cases["cases"][case], [], []
    _spy(monkeypatch, "visibility", visible)
    _spy(monkeypatch, "kept_offsets", kept)
    number = first_step(case, "offsets used")
    found, count = step(given, case, number), len(expected["mean_visible"])
    ways = [torch.stack(visible[:count], 1), torch.stack(visible[count:], 1)]  # pair, iteration
    means = torch.stack(ways, 1).mean((0, 1, 3, 4, 5)).flip(0).tolist()
    assert means == pytest.approx(expected["mean_visible"], rel=1e-5)
    last = torch.stack(ways, 1)[:, :, -1, :, ::2, ::2].numpy()
    assert (np.abs(last - given.arrays[f"{case}/visible_last"]) > 1e-4).mean() <= 1e-4
    offsets = torch.stack(kept, 1)
    wanted = np.unpackbits(given.arrays[f"{case}/kept"]).reshape(offsets.shape)
    assert wanted.mean() == pytest.approx(expected["steps"][str(number)]["kept"], rel=1e-5)
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
    assert digest(made) == read(keys.parent)[0]["digest"]
    network = Corrector()
    network.load_state_dict({key: torch.from_numpy(value) for key, value in made.items()}, strict=True)
    return network


def _corrected(network: Corrector, given: Given) -> tuple[Tensor, Tensor, Tensor]:
    """The corrector's images, its colour offsets for them, and its loss."""
    rule = r"first (\d+)x(\d+) px of the corrector input of case (\w+), step (\d+)"
    stated = re.fullmatch(rule, given.cases["corrector"]["input"])
    assert stated
    height, width, number = int(stated[1]), int(stated[2]), int(stated[4])
    images = [image[..., :height, :width] for _, _, image in step(given, stated[3], number).asked[:2]]
    together = torch.stack(images, 1).flatten(0, 1)
    offsets = network(together).unflatten(0, (-1, 2))
    return together, offsets, (offsets - torch.linspace(-0.3, 0.3, width)).abs().mean()


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


def test_learning_rates_equal_the_originals(given):
    recipe = load_recipe("brightflow", "unsupervised")
    assert recipe.updates == recipe.steps
    for update, rate in given.cases["rates"]:
        assert SCHEDULES[recipe.schedule](update, recipe.steps, recipe.learning_rate) == pytest.approx(rate, rel=1e-9)


_census, _offsets, _students = objective._census, objective.Brightflow._offsets, objective.Brightflow._students
_coverage, _charbonnier, _smoothness = losses.coverage, losses.charbonnier, objective.robust_smoothness


def _target_corrected(self, frame, frames, ways, place):
    flow, visible = ways[frame].flows[-1].detach(), ways[frame].visible[-1]
    warped = objective._warped(frames.whole[1 - frame], flow, place)
    offsets = self._offsets(frame, frames, ways, place) * visible
    return losses.correction_loss(frames.crops[frame] + offsets, warped, visible)


def _ones(flow: Tensor, *rest: Any) -> Tensor:
    return torch.ones_like(flow[:, :1])


def _kept_at_the_target(target, warped, corrected, flow):
    return ((target - corrected).abs().mean(1, True) < (target - warped).abs().mean(1, True)).float()


MISTAKES: dict[str, tuple[Any, str, Any]] = {
    "unit range": (objective, "robust_smoothness", lambda flow, image, *rest: _smoothness(flow, image / 255, *rest)),
    "half smoothness": (objective, "robust_smoothness", lambda *args: _smoothness(*args) / 2),
    "usual grey": (losses, "LUMA", terms.LUMA),
    "last mask": (
        objective,
        "_census",
        lambda image, source, way, place: _census(
            image, source, way._replace(visible=way.visible[-1:] * len(way.visible)), place
        ),
    ),
    "one quotient": (losses, "masked_mean", lambda values, mask: (values * mask).sum() / mask.sum()),
    "all visible": (objective, "visibility", _ones),
    "hard coverage": (losses, "coverage", lambda flow, *values: (_coverage(flow, *values) >= 0.2).float()),
    "crop is all": (losses, "leaves", lambda flow: torch.zeros_like(flow[:, :1])),
    "target corrected": (objective.Brightflow, "_correction", _target_corrected),
    "half offsets": (objective.Brightflow, "_offsets", lambda *args: _offsets(*args) / 2),
    "mean of colours": (objective, "correction_loss", lambda *args: losses.correction_loss(*args) / 3),
    "clamped correction": (objective, "with_offsets", lambda *args: losses.with_offsets(*args).clamp(0, 255)),
    "all kept": (objective, "kept_offsets", lambda target, warped, corrected, flow: _ones(flow)),
    "kept at the target": (objective, "kept_offsets", _kept_at_the_target),
    "edge pixels not black": (terms, "inside_frame", _ones),
    "teacher sees augmented": (
        objective.Brightflow,
        "_students",
        lambda self, batch, plain: _students(self, batch, plain._replace(crops=(batch.image1, batch.image2))),
    ),
    "half self": (objective, "self_supervised", lambda *args: losses.self_supervised(*args) / 2),
    "clamped differences": (losses, "charbonnier", lambda differences: _charbonnier(differences).clamp(0, 10)),
    "low limit": (objective, "FARTHEST", 50.0),
}
"""What each mistake replaces, and with what; "augmented compared" changes the batch instead."""


@pytest.mark.parametrize(
    ("mistake", "occlusion", "phase", "term"),
    [
        ("unit range", "brox", "start", "smooth"),
        ("unit range", "wang", "start", "smooth"),
        ("half smoothness", "brox", "start", "smooth"),
        ("usual grey", "brox", "start", "photo"),
        ("last mask", "brox", "start", "photo"),
        ("last mask", "wang", "start", "photo"),
        ("one quotient", "brox", "start", "photo"),
        ("one quotient", "wang", "start", "photo"),
        ("all visible", "brox", "start", "photo"),
        ("hard coverage", "wang", "start", "photo"),
        ("crop is all", "brox", "start", "photo"),
        ("augmented compared", "brox", "start", "photo"),
        ("augmented compared", "brox", "start", "smooth"),
        ("target corrected", "brox", "corrector learns", "correc"),
        ("half offsets", "brox", "corrector learns", "correc"),
        ("mean of colours", "brox", "corrector learns", "correc"),
        ("clamped correction", "brox", "corrector learns", "correc"),
        ("half offsets", "wang", "offsets used", "photo"),
        ("all kept", "brox", "offsets used", "photo"),
        ("kept at the target", "brox", "offsets used", "photo"),
        ("edge pixels not black", "brox", "start", "photo"),
        ("teacher sees augmented", "brox", "student learns", "self"),
        ("half self", "brox", "student learns", "self"),
        ("clamped differences", "brox", "student learns", "self"),
        ("low limit", "brox", "student learns", "loss_total"),
    ],
)
def test_mistake_moves_the_term_beyond_its_tolerance(given, monkeypatch, mistake, occlusion, phase, term):
    case = next((case for case, stated in CASES.items() if stated["occlusion"] == occlusion), None)
    if case is None:
        pytest.skip(f"the pack has no case with the occlusion {occlusion}")
    if mistake == "augmented compared":
        given.batch = replace(given.batch, plain=given.batch.whole)
    else:
        monkeypatch.setattr(*MISTAKES[mistake])
    number = first_step(case, phase)
    expected = CASES[case]["steps"][str(number)][term]
    assert abs(step(given, case, number).terms[term] / expected - 1) > LOSS

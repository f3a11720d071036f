"""White-box attacks notice a gradient that does not belong to the flow."""

from __future__ import annotations

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.problem import Pair, check_same_flow
from robustflow.core.errors import ModelError
from robustflow.core.rng import Rng
from robustflow.testing import check_model

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .small_attacks import attacked_pair  # noqa: E402
from .smooth_net import Given, random_pair, smooth_model  # noqa: E402


class Distorted(Given):
    """A model whose `differentiable` returns a distorted flow."""

    name = "distorted"

    def __init__(self, distort) -> None:
        super().__init__(smooth_model().function)
        self.distort = distort

    def differentiable(self, images1, images2):
        return self.distort(super().differentiable(images1, images2))


DISTORTIONS = {
    "halved": lambda flow: flow / 2,
    "swapped": lambda flow: flow.flip(1),
    "backward": lambda flow: -flow,
    "shifted": lambda flow: flow.roll(3, 3),
    "nan": lambda flow: flow * np.nan,
}


class Noise(torch.autograd.Function):
    """Identity with a gradient of noise."""

    @staticmethod
    def forward(ctx, images):
        return images.clone()

    @staticmethod
    def backward(ctx, gradient):
        return torch.randn(gradient.shape, generator=torch.Generator().manual_seed(int(1e6 * gradient.abs().sum())))


def with_gradient(change) -> Given:
    """The smooth network, with its images changed by a function that changes only the gradient."""
    net = smooth_model().function
    return Given(lambda images1, images2: net(change(images1), change(images2)))


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_a_differentiable_flow_that_differs_from_predict_is_refused(distortion):
    model = Distorted(DISTORTIONS[distortion])

    for refused in (lambda: check_model(model), lambda: attacked_pair("pgd", model)):
        with pytest.raises(ModelError, match=r"'?[Dd]istorted'?.* px from the flow of predict"):
            refused()
    attacked_pair("square", model)  # needs no gradient


def test_the_surrogate_of_a_transfer_and_the_parts_of_a_worst_case_are_checked():
    model = Distorted(DISTORTIONS["halved"])

    for name, options in (("transfer", {"on": model}), ("worst_of", {})):
        with pytest.raises(ModelError, match="flow of predict"):
            attacked_pair(name, model if name == "worst_of" else smooth_model(), **options)


def test_flows_that_differ_by_rounding_or_where_predict_is_nan_agree():
    flow = np.random.default_rng(0).normal(0, 3, (5, 6, 2)).astype(np.float32)
    gap = flow.copy()
    gap[0] = np.nan

    check_same_flow(None, flow * 1.01, flow, "here")
    check_same_flow(None, flow, gap, "here")
    check_same_flow(None, flow, gap * np.nan, "here")
    with pytest.raises(ModelError):
        check_same_flow(None, flow * 1.1, flow, "here")
    check_same_flow(None, flow * 0 + 0.005, flow * 0, "here")
    with pytest.raises(ModelError):
        check_same_flow(None, flow * 0 + 0.02, flow * 0, "here")


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("change", [Noise.apply, lambda images: images + 2 * (images.detach() - images)])
def test_a_gradient_of_noise_or_of_the_wrong_sign_is_detected(change, seed):
    assert "gradient_misleading" in attacked_pair("pgd", with_gradient(change), seed=seed)[1].warnings


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "options", [{}, {"target": "negative"}, {"loss": "cosine"}, {"norm": "rms"}, {"moved": "first"}]
)
def test_a_correct_gradient_is_not_doubted(options, seed):
    for name in ("pgd", "cospgd"):
        warnings = attacked_pair(name, seed=seed, **options)[1].warnings
        assert not {"gradient_misleading", "square_above_white_box"} & set(warnings)


def test_a_short_run_of_square_beats_an_attack_with_a_misleading_gradient():
    def reversed_gradient(images1, images2):
        total = images1 + images2
        return 10 * (total + 2 * (total.detach() - total))[:, :2]

    wrong, pair, truth = Given(reversed_gradient), random_pair(), np.zeros((8, 10, 2), np.float32)

    for options in ({}, {"norm": "rms"}, {"moved": "joint"}):
        attacked = rf.attack(*pair, wrong, "bim", 4, flow=truth, steps=3, **options)
        assert "square_above_white_box" in attacked.warnings
        assert (attacked.evaluations, attacked.gradients) == (4, 3)
    assert "square_above_white_box" not in rf.attack(*pair, wrong, "bim", 1, flow=truth, norm="rms").warnings


def test_training_checks_the_gradient():
    model = Distorted(DISTORTIONS["halved"])
    pair = Pair(random_pair(), 4.0, np.zeros((8, 10, 2), np.float32))

    with pytest.raises(ModelError, match="flow of predict"):
        load_attack("universal:train=1").learn(model, [(pair, model.predict(*pair.frames))], Rng.of(0))

"""Attacks reach known optima, return the best evaluated pair, and outperform noise of the same norm."""

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks.ball import images_of

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .smooth_net import FEW, Given, attacked_pair, linear_model, random_pair, smooth_model  # noqa: E402  # noqa: E402


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd"])
def test_sign_attacks_on_a_linear_model_reach_the_optimum(name):
    model, clean, budget = linear_model(), random_pair(), 4
    _, attacked = attacked_pair(name, model, severity=3, **({"steps": 20} if name in ("bim", "pgd") else {}))
    levels = np.stack(clean).astype(int).transpose(0, 3, 1, 2)
    # u is positive and bounded away from 0
    best = np.clip(levels + budget * np.sign(model.weights).astype(int), 0, 255)
    assert np.array_equal(np.stack(attacked.frames).transpose(0, 3, 1, 2), best)


@pytest.mark.parametrize("name", ["bim", "apgd"])
def test_attacks_under_rms_on_a_linear_model_reach_the_optimum_of_the_sphere(name):
    model = linear_model()
    grey = np.full((2, 8, 10, 3), 128, np.uint8)  # far from 0 and 255, so that only the norm constraint is active
    truth = np.zeros((8, 10, 2), np.float32)
    attacked = rf.attack(*grey, model, name, 4, flow=truth, norm="rms", steps=60)
    change = attacked.images - images_of(*grey)
    optimum = model.weights / np.sqrt((model.weights**2).mean()) * 5 / 255
    assert np.abs(change - optimum).max() < 1e-3 * np.abs(optimum).max()


@pytest.mark.parametrize("name", ["bim", "pgd", "cospgd", "apgd", "pcfa", "square", "worst_of"])
def test_attack_returns_the_clean_pair_if_every_change_helps_the_model(name):
    clean = torch.from_numpy(images_of(*random_pair()))

    def already_at_the_target(images1, images2):
        return ((images1 - clean[:1]).abs() + (images2 - clean[1:]).abs())[:, :2]

    pair, attacked = attacked_pair(name, Given(already_at_the_target), target="zero")
    assert np.array_equal(attacked.frames, pair)
    assert attacked.loss == attacked.clean_loss == 0
    assert "nothing_gained" in attacked.warnings


def test_an_attack_whose_gain_is_lost_in_rounding_returns_the_clean_pair():
    """The flow grows up to a change of 0.6 grey levels and is smaller at a change of 1 grey level."""
    clean = torch.from_numpy(images_of(*random_pair()))

    def ridge(images1, images2):
        up = (images1 - clean[:1]) * 255
        return (10 + torch.where(up < 0.6, up, -3 * up))[:, :2] + 0 * images2[:, :2]

    options = {"budget": 1, "flow": np.zeros((8, 10, 2), np.float32), "steps": 9}
    attacked = rf.attack(*random_pair(), Given(ridge), "bim", **options)
    assert np.array_equal(attacked.frames, random_pair())
    assert attacked.loss == attacked.float_loss == attacked.clean_loss
    assert {"nothing_gained", "rounding"} <= set(attacked.warnings)


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "cospgd", "apgd", "square"])
def test_attacks_beat_random_noise_of_the_same_norm(name):
    noise = attacked_pair("random_sign")[1].loss
    assert attacked_pair(name, **({"queries": 300} if name == "square" else {}))[1].loss > noise


@pytest.mark.parametrize("target", ["zero", "negative"])
def test_pcfa_brings_the_flow_nearer_to_its_target_than_noise_does(target):
    # at severity 4, LBFGS without a line search jumps so far that rounding errors decide whether it gains anything
    _, attacked = attacked_pair("pcfa", severity=3, target=target, steps=5)
    _, noise = attacked_pair("random_gauss", severity=3, target=target)
    assert attacked.clean_loss - attacked.loss > 10 * abs(attacked.clean_loss - noise.loss)
    goal = 0 if target == "zero" else -attacked.clean_flow
    flows = (flow.astype(np.float64) for flow in (attacked.clean_flow, attacked.flow))
    before, after = (np.linalg.norm(flow - goal, axis=-1).mean() for flow in flows)
    assert attacked.way_gone == pytest.approx((before - after) / before)


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd"])
def test_without_truth_an_attack_begins_at_random_and_moves_the_flow(name):
    pair, model = random_pair(), smooth_model()
    attacked = rf.attack(*pair, model, name, 4, **FEW.get(name, {}))
    noise = rf.attack(*pair, model, "random_sign", 4)
    assert attacked.moved > noise.moved > 0
    assert "gradient_zero" not in attacked.warnings

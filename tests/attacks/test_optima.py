"""Attacks reach known optima, alone and composed; the names of attacks with options."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.ball import images_of
from robustflow.attacks.registry import attack_spec
from robustflow.core.errors import UsageError

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .smooth_net import FEW, TRUTH, Given, attacked_pair, linear_model, random_pair, smooth_model  # noqa: E402


@pytest.mark.parametrize("name", ["fgsm", "bim", "pgd", "apgd"])
def test_sign_attacks_on_a_linear_model_reach_the_optimum(name):
    model, clean, budget = linear_model(), random_pair(), 4
    _, attacked = attacked_pair(name, model, severity=3, **({"steps": 20} if name in ("bim", "pgd") else {}))
    levels = np.stack(clean).astype(int).transpose(0, 3, 1, 2)
    # u is positive and bounded away from 0
    best = np.clip(levels + budget * np.sign(model.weights).astype(int), 0, 255)
    assert np.array_equal(np.stack(attacked.frames).transpose(0, 3, 1, 2), best)


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


@pytest.mark.parametrize("name", ["fgsm", "pgd", "apgd", "pcfa"])
def test_transfer_to_its_own_surrogate_equals_the_attack(name):
    options = FEW.get(name, {})
    _, alone = attacked_pair(name, norm="rms")
    transfer = load_attack("transfer", on=smooth_model(), attack=name, norm="rms", **options)
    transferred = rf.attack(*random_pair(), smooth_model(), transfer, 4, flow=TRUTH)
    assert np.array_equal(alone.frames, transferred.frames)
    assert transferred.loss == pytest.approx(alone.loss)


def test_a_transfer_without_truth_moves_away_from_the_other_models_flow():
    pair, other = random_pair(), smooth_model()
    own = linear_model()
    frames = [rf.attack(*pair, model, "transfer", 4, on=other, attack="bim").frames for model in (own, other)]
    assert np.array_equal(*frames)  # the attacked model does not affect the result


def test_a_transfer_fits_a_model_without_gradients():
    frame = random_pair(40, 48)
    attacked = rf.attack(*frame, "dis", "transfer:tiny:attack=fgsm", 3)
    assert attacked.linf == 4
    assert attacked.moved > 0


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.booleans())
def test_the_worst_of_attacks_is_never_better_for_the_model_than_one_of_them(seed, severity, with_truth):
    pair, model = random_pair(seed=seed), smooth_model()
    options = {"seed": seed, "flow": TRUTH if with_truth else None}
    parts = {"random_sign": {}, "fgsm": {}, "pgd": {"steps": 3}, "square": {"queries": 10}}
    worst = rf.attack(*pair, model, "worst_of:random_sign+fgsm+pgd+square:steps=3:queries=10", severity, **options)
    each = [rf.attack(*pair, model, name, severity, **options, **mine) for name, mine in parts.items()]
    assert worst.loss == max(worst.clean_loss, *(one.loss for one in each))
    assert worst.evaluations == sum(one.evaluations for one in each) + len(each)


@pytest.mark.parametrize(
    ("given", "label"),
    [
        ("pgd:steps=20", "pgd"),
        ("pgd:loss=cosine:steps=40", "pgd:loss=cosine:steps=40"),
        ("pcfa:target=negative", "pcfa:target=negative"),
        ("transfer:ptlflow:raft:checkpoint=things", "transfer:ptlflow:raft:checkpoint=things"),
        ("transfer:raft:steps=40:attack=pgd", "transfer:raft:attack=pgd:steps=40"),
        ("transfer", "transfer:tiny"),
        ("worst_of", "worst_of:apgd+square"),
        ("worst_of:square+apgd:steps=3:queries=7", "worst_of:square+apgd:queries=7:steps=3"),
        ("worst_of:square+transfer:attack=pgd:steps=4", "worst_of:square+transfer:attack=pgd:steps=4"),
        ("worst_of:patch+random_patch", "worst_of:patch+random_patch"),
        ("transfer:attack=patch", "transfer:tiny:attack=patch"),
        ("worst_of:pcfa+apgd:norm=rms:target=zero", "worst_of:pcfa+apgd:target=zero:norm=rms"),
    ],
)
def test_the_name_of_an_attack_in_a_run_has_its_options_and_gives_it_again(given, label):
    attack = load_attack(given)
    assert attack.label == label
    assert load_attack(label) == attack
    assert attack_spec(label).norm == attack.norm


@pytest.mark.parametrize(
    "parts", [["pgd:steps=5", "apgd"], "pgd:steps=5+apgd", "transfer:tiny+transfer:dis", [load_attack("pgd"), "apgd"]]
)
def test_a_worst_of_whose_label_would_give_other_attacks_is_refused(parts):
    with pytest.raises(UsageError) as caught:
        load_attack("worst_of", parts=parts)
    assert caught.value.culprit in ("pgd", "pgd:steps=5", "apgd", "transfer:tiny", "transfer:dis", "parts")


def test_a_variant_reaches_the_attacks_inside_others_unless_they_have_one():
    names = ("pgd", "apgd", "transfer:tiny:attack=pgd", "worst_of:apgd+pgd", "pcfa:variant=original")
    transfer, worst = (load_attack(name).with_variant("flowbench") for name in names[2:4])
    assert [load_attack(name).with_variant("flowbench").variant for name in names] == [
        *("flowbench", "default", "flowbench", "default", "original")
    ]
    assert transfer.attack.variant == "flowbench"
    assert [part.variant for part in worst.parts] == ["default", "flowbench"]

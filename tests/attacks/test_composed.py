"""Composite attacks, and the names of attacks with options."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.attacks import load_attack
from robustflow.attacks.registry import norm_of
from robustflow.core.errors import UsageError

pytest.importorskip("torch", reason="needs the torch extra")

from .smooth_net import FEW, TRUTH, attacked_pair, linear_model, random_pair, smooth_model


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
    assert norm_of(label) == attack.norm


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

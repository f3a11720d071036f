"""Attacks check what they require of a model, and detect problems with its flow and gradient."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks.ball import images_of

torch = pytest.importorskip("torch", reason="needs the torch extra")

from .small_attacks import ON_SMALL_PAIRS, attacked_pair  # noqa: E402
from .smooth_net import Given, random_pair  # noqa: E402


def test_the_clean_pair_is_predicted_twice_to_know_whether_the_answers_differ():
    asked = []

    def counted(frame1, frame2):
        asked.append(frame1)
        return np.zeros((*frame1.shape[:2], 2), np.float32)

    rf.attack(*random_pair(), counted, "random_sign", 4)

    assert len(asked) == 3  # the clean pair twice, and the attacked pair


def test_attacks_count_their_evaluations():
    costs = {name: attacked_pair(name)[1] for name in ON_SMALL_PAIRS}

    assert {name: (one.evaluations, one.gradients) for name, one in costs.items()} == {
        "random_sign": (0, 0),
        "random_gauss": (0, 0),
        "fgsm": (1, 1),
        "bim": (5, 4),
        "pgd": (5, 4),
        "cospgd": (5, 4),
        "apgd": (13, 13),
        "pcfa": (23, 21),
        "square": (30, 0),
        "transfer": (5, 4),
        "worst_of": (33, 1),
    }


def test_a_model_that_hides_its_gradient_is_detected():
    def without_gradient(images1, images2):
        return 3 * (images1 + images2).round()[:, :2] + 0 * images1[:, :2]

    _, attacked = attacked_pair("pgd", Given(without_gradient))

    assert "gradient_zero" in attacked.warnings


def test_a_gradient_that_is_nan_is_detected():
    def root(images1, images2):
        return torch.sqrt(images1 * 0)[:, :2] + images2[:, :2]

    _, attacked = attacked_pair("pgd", Given(root))

    assert "gradient_not_finite" in attacked.warnings


@pytest.mark.parametrize("name", ["tiny", "raft_small", "ptlflow:raft_small", "arflow"])
def test_the_differentiable_flow_of_a_model_is_its_prediction(name):
    if name == "raft_small":
        pytest.importorskip("torchvision", reason="needs torchvision")
    if name.startswith("ptlflow"):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    options = {} if name == "tiny" else {"checkpoint": "random"}
    model = rf.load_model(name, device="cpu", **options)
    pair = random_pair(125, 133)
    predicted = model.predict(*pair)

    images = torch.from_numpy(images_of(*pair)).requires_grad_()
    flow = model.differentiable(images[:1], images[1:])
    flow.sum().backward()

    assert np.abs(flow[0].permute(1, 2, 0).detach().numpy() - predicted).max() < 2e-3
    assert torch.isfinite(images.grad).all()
    assert images.grad[0].any()
    assert images.grad[1].any()
    assert images.grad[:, :, :, -1].any()
    assert images.grad[:, :, -1].any()


@pytest.mark.parametrize("name", ["pgd", "apgd", "pcfa", "square"])
def test_a_flow_that_becomes_nan_is_never_the_best_and_one_that_is_nan_is_no_gain(name):
    clean = torch.from_numpy(images_of(*random_pair())[:1])

    def nan_elsewhere(images1, images2):
        return torch.where((images1 - clean).abs() < 1e-3, images1, images1 * np.nan)[:, :2]

    _, moved = attacked_pair(name, Given(nan_elsewhere))
    _, always = attacked_pair(name, Given(lambda images1, images2: images1[:, :2] * np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, infinite = attacked_pair(name, Given(lambda images1, images2: (images1[:, :2] + 1) * np.inf))

    for attacked in (moved, always, infinite):
        assert np.array_equal(attacked.frames, random_pair())
        assert "nothing_gained" in attacked.warnings


def test_attack_registry_and_square_work_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import numpy as np, robustflow as rf\n"
        "from robustflow.attacks.registry import ATTACKS\n"
        "assert [ATTACKS.get(name) for name in rf.list_attacks()]\n"
        "frame = (np.arange(40 * 48 * 3) % 251).astype(np.uint8).reshape(40, 48, 3)\n"
        "print(rf.attack(frame, frame, 'dis', 'square', 2, queries=3).linf)"
    )

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert done.stdout == "2.0\n"

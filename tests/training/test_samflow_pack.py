"""SAMFlow-T's training steps (optimiser steps of one pair each) match the original code."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("ptlflow", reason="needs the ptlflow extra")

from robustflow.training.data.loader import Batch  # noqa: E402
from robustflow.training.network_with_loss import loss_of_batch  # noqa: E402
from robustflow.training.recipe import Recipe, load_recipe  # noqa: E402

from ..shared_data import shared_folder  # noqa: E402
from .pack_steps import TrainingPack, steps  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.parity]

LOSS, NORM, GRADIENT, AFTER = (2e-6, 2e-5), (1e-4, 5e-4), 5e-3, 1e-5
"""Tolerances from the pack's README: for the loss and the gradient norm, relative, in the first step and in later ones;
for a gradient, relative to its largest value; and for the final weights, absolute.
"""
NO_GRADIENT = ("k_proj.bias", ".k.bias")
"""Parameters whose true gradient is 0, because softmax cancels any value added to all scores."""


@pytest.fixture(scope="module")
def pack() -> TrainingPack:
    return TrainingPack.read(shared_folder("parity", "training_samflow_t"))


@pytest.fixture(scope="module")
def recipe(pack) -> Recipe:
    """The recipe with the settings of the pack's stage and one pair per update."""
    header, ood = pack.header, load_recipe("samflow_t", "ood")
    assert (header["lr"], header["clip"]) == (ood.learning_rate, ood.optimizer.clip)
    return ood.changed(
        steps=header["num_steps"],
        batch=1,
        accumulate=1,
        iterations=len(header["steps"][0]["l1"]),
        gamma=header["gamma"],
        optimizer={**ood.optimizer.model_dump(), "weight_decay": header["wdecay"]},
    )


def alone(batch: Batch, number: int) -> Batch:
    """One pair of a batch, because the original code uses one pair per process."""
    only = slice(number, number + 1)
    return Batch(batch.image1[only], batch.image2[only], batch.flow[only], batch.valid[only], batch.names[only])


def test_steps_of_samflow_equal_the_originals(pack, recipe):
    network, batch = pack.network(recipe), pack.batch()
    expected, found = pack.header["steps"], []
    pairs = [alone(batch, stated["item"]) for stated in expected]
    for number, step in enumerate(steps(network, recipe, pairs.__getitem__, len(expected))):
        found.append(step)
        assert step.loss == pytest.approx(expected[number]["loss"], rel=LOSS[number > 0])
        assert step.norm == pytest.approx(expected[number]["grad_norm"], rel=NORM[number > 0])
        assert step.rate == pytest.approx(expected[number]["rate"], rel=1e-9)
    first, norms = found[0], expected[0]["gradient_norms"]
    assert first.gradients.keys() == {name for name, norm in norms.items() if norm}  # None if frozen, 0 if unused
    for name, gradient in first.gradients.items():
        if not name.endswith(NO_GRADIENT):
            assert gradient.norm().item() == pytest.approx(norms[name], rel=GRADIENT), name
    np.testing.assert_allclose(first.flows[-1][..., ::2, ::2], pack.arrays["flow_last"], atol=2e-3)
    for key, wanted in pack.arrays.items():
        kind, _, name = key.partition("/")
        if kind == "gradient":
            assert np.abs(first.gradients[name].numpy() - wanted).max() <= GRADIENT * np.abs(wanted).max()
        elif kind == "after":
            np.testing.assert_allclose(network.weights()[name], wanted, atol=AFTER)


def test_pairs_of_one_batch_do_not_affect_each_other(pack, recipe):
    """The original code uses one pair per process; with more, contexts would be mixed as in FlowFormer."""
    network, batch = pack.network(recipe), pack.batch()
    with torch.no_grad():
        together, *singly = (
            loss_of_batch(network, one, recipe)[0].item()
            for one in (batch, *(alone(batch, number) for number in range(len(batch.names))))
        )
    assert together == pytest.approx(np.mean(singly), rel=LOSS[1])

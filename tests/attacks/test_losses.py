"""Losses of attacks: their gradients, and the pixels that they include."""

from __future__ import annotations

import numpy as np
import pytest

import robustflow as rf
from robustflow.attacks.loss import LOSSES, Loss

pytest.importorskip("torch", reason="needs the torch extra")

from .smooth_net import random_pair, smooth_model


@pytest.mark.parametrize("agreeing", [False, True])
@pytest.mark.parametrize("kind", LOSSES)
def test_the_slope_of_a_loss_is_its_derivative(kind, agreeing):
    rng = np.random.default_rng(0)
    flow, reference = (rng.normal(0, 2, (5, 6, 2)).astype(np.float32) for _ in range(2))
    valid = rng.random((5, 6)) < 0.6
    loss = Loss(reference, valid, kind, agreeing=agreeing)
    weight = loss._parts(flow, True)[0] / np.maximum(loss._parts(flow, False)[0], 1e-30)
    plain = Loss(reference, valid, kind)

    value, slope = loss.slope(flow)

    numbers = np.zeros_like(slope)
    for at in np.ndindex(*flow.shape):  # the weight of CosPGD is held constant
        step = np.zeros(flow.shape)
        step[at] = 1e-4
        ahead, behind = (plain._parts((flow + sign * step).astype(np.float64), False)[0] for sign in (1, -1))
        numbers[at] = ((ahead - behind) * weight)[valid].mean() / 2e-4
    assert value == pytest.approx((plain._parts(flow, False)[0] * weight)[valid].mean())
    assert np.abs(slope - numbers).max() < 1e-3 * np.abs(numbers).max()
    assert not slope[~valid].any()


def test_a_capped_pixel_counts_the_diagonal_and_pulls_no_more():
    flow = np.zeros((3, 4, 2), np.float32)
    flow[0, 0] = (300, 400)

    value, slope = Loss(np.zeros_like(flow), kind="capped").slope(flow)

    assert value == pytest.approx(5 / 12)
    assert not slope.any()


def test_pixels_without_truth_do_not_steer_an_attack_and_do_in_flowbench():
    pair, model = random_pair(), smooth_model()
    truth = np.zeros((8, 10, 2), np.float32)
    valid = np.zeros((8, 10), bool)
    valid[:, :5] = True
    other = truth.copy()
    other[~valid] = 50

    def frames(flow, variant):
        return rf.attack(*pair, model, "pgd", 4, flow=flow, valid=valid, steps=4, variant=variant).frames

    assert np.array_equal(frames(truth, "default"), frames(other, "default"))
    without_mask = rf.attack(*pair, model, "pgd", 4, flow=truth, steps=4, variant="flowbench").frames
    # flow 0 where there is no ground truth, but included
    assert np.array_equal(frames(other, "flowbench"), without_mask)

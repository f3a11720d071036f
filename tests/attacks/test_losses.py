"""Losses of attacks agree with formulas written out for one pixel at a time, and their slopes with differences of these
formulas; without PyTorch."""

import math

import numpy as np
import pytest

from robustflow.attacks.loss import LOSSES, Loss

HEIGHT, WIDTH = 3, 4


def distance(kind: str, u: float, v: float, x: float, y: float) -> float:
    length = math.sqrt((u - x) ** 2 + (v - y) ** 2)
    if kind == "capped":
        return min(length, math.sqrt(HEIGHT**2 + WIDTH**2))
    if kind == "mse":
        return ((u - x) ** 2 + (v - y) ** 2) / 2
    if kind == "cosine":
        lengths = math.sqrt(u**2 + v**2) * math.sqrt(x**2 + y**2)
        return 1 - (u * x + v * y) / lengths if lengths else 1.0
    return length


def agreement(u: float, v: float, x: float, y: float) -> float:
    """CosPGD's weight: the cosine between the softmax of (u, v) and that of (x, y)."""
    p, q = 1 / (1 + math.exp(v - u)), 1 / (1 + math.exp(y - x))
    return (p * q + (1 - p) * (1 - q)) / math.sqrt((p**2 + (1 - p) ** 2) * (q**2 + (1 - q) ** 2))


def flows(seed: int = 0):
    """A flow, a reference and a mask; some pixels are further apart than the frame's diagonal of 5 px."""
    rng = np.random.default_rng(seed)
    flow, reference = rng.normal(0, 2, (2, HEIGHT, WIDTH, 2)).astype(np.float32)
    flow[0, 0] += (30, -20)
    flow[1, 1] -= (4.5, 0.2)
    valid = np.ones((HEIGHT, WIDTH), bool)
    valid[1, 2] = valid[2, 0] = False
    return flow, reference, valid


def expected(kind, flow, reference, valid, weights):
    """The weighted mean distance over the valid pixels."""
    values = [
        weights[at] * distance(kind, *map(float, flow[at]), *map(float, reference[at]))
        for at in np.ndindex(valid.shape)
        if valid[at]
    ]
    return math.fsum(values) / len(values)


def weights_of(flow, reference, agreeing, towards):
    weights = np.ones(flow.shape[:2])
    for at in np.ndindex(weights.shape) if agreeing else ():
        weights[at] = agreement(*map(float, flow[at]), *map(float, reference[at]))
        weights[at] = 1 - weights[at] if towards else weights[at]
    return weights


@pytest.mark.parametrize("towards", [False, True])
@pytest.mark.parametrize("agreeing", [False, True])
@pytest.mark.parametrize("kind", LOSSES)
def test_a_loss_and_its_slope_equal_the_formula_of_each_pixel(kind, agreeing, towards):
    flow, reference, valid = flows()
    loss = Loss(reference, valid, kind, towards, agreeing)
    weights = weights_of(flow, reference, agreeing, towards)
    value, slope = loss.slope(flow)
    assert loss.of(flow) == pytest.approx(expected(kind, flow, reference, valid, weights), rel=1e-6)
    assert loss.of(flow, weighted=False) == pytest.approx(
        expected(kind, flow, reference, valid, np.ones_like(weights)), rel=1e-6
    )
    assert value == loss.of(flow)
    assert slope.dtype == np.float32
    for at in np.ndindex(flow.shape):  # the weight has no gradient
        ahead, behind = flow.astype(np.float64), flow.astype(np.float64)
        ahead[at] += 1e-5
        behind[at] -= 1e-5
        rise = expected(kind, ahead, reference, valid, weights) - expected(kind, behind, reference, valid, weights)
        assert slope[at] == pytest.approx(rise / 2e-5, rel=1e-4, abs=1e-7)


def test_weights_of_long_vectors_do_not_overflow():
    reference = np.full((HEIGHT, WIDTH, 2), (500, -500), np.float32)
    flow = np.full((HEIGHT, WIDTH, 2), (900, -900), np.float32)
    assert Loss(reference, agreeing=True).of(flow) == pytest.approx(400 * 2**0.5)
    assert Loss(-reference, agreeing=True).of(flow) == 0


@pytest.mark.parametrize("kind", LOSSES)
def test_the_slope_of_zero_vectors_is_zero_and_finite(kind):
    zero = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    value, slope = Loss(zero, kind=kind).slope(zero)
    assert value == (1 if kind == "cosine" else 0)
    assert not slope.any()

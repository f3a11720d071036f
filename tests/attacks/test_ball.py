"""Balls agree with slow, independent formulas in double precision; without PyTorch."""

import numpy as np
import pytest

from robustflow.attacks import Attack, load_attack
from robustflow.attacks.ball import MOVED, Ball
from robustflow.attacks.registry import SHIPPED
from robustflow.core.errors import UsageError
from robustflow.core.rng import Rng

SHAPE = (4, 5, 3)
FRAMES = {"both": (0, 1), "first": (0,), "second": (1,), "joint": (0, 1)}


def ball_of(budget=10.0, norm="linf", moved="both", per_frame=False, seed=0) -> Ball:
    rng = np.random.default_rng(seed)
    return Ball(*np.clip(rng.integers(-20, 275, (2, *SHAPE)), 0, 255).astype(np.uint8), budget, norm, moved, per_frame)


def change_of(seed=0, scale=0.1):
    return np.random.default_rng(seed).normal(0, scale, (2, 3, 4, 5)).astype(np.float32)


def levels(ball):
    return np.stack([ball.frame1, ball.frame2]).astype(np.float64).transpose(0, 3, 1, 2)


def rms(change, moved, per_frame):
    sizes = [np.mean(change[frame] ** 2) for frame in FRAMES[moved]]
    return np.sqrt(max(sizes) if per_frame else np.mean(sizes))


def projected(ball, change):
    """The change of a projected pair, float64."""
    change, clean = change.astype(np.float64).copy(), levels(ball) / 255
    for frame in {0, 1} - set(FRAMES[ball.moved]):
        change[frame] = 0
    if ball.moved == "joint":
        change[:] = (change[0] + change[1]) / 2
    radius = ball.budget / 255
    if ball.norm == "linf":
        change = np.clip(change, -radius, radius)
    elif ball.norm == "area":
        allowed = int(ball.budget * 20 / 100)
        for frame in change:
            sizes = sorted((-np.abs(frame[:, y, x]).max(), y, x) for y in range(4) for x in range(5))
            for _, y, x in sizes[allowed:]:
                frame[:, y, x] = 0
    elif ball.per_frame:
        for frame in change:
            frame *= min(1, radius / max(np.sqrt(np.mean(frame**2)), 1e-9))
    else:
        change *= min(1, radius / rms(change, ball.moved, False))
    if ball.moved == "joint":
        change = np.clip(change, -np.minimum(*clean), 1 - np.maximum(*clean))
    return np.clip(clean + change, 0, 1) - clean


BALLS = [("linf", False), ("rms", False), ("rms", True), ("area", False)]


@pytest.mark.parametrize("scale", [0.01, 0.2])
@pytest.mark.parametrize("moved", MOVED)
@pytest.mark.parametrize(("norm", "per_frame"), BALLS)
def test_a_projected_pair_equals_the_formula_and_is_held(norm, per_frame, moved, scale):
    ball, change = ball_of(norm=norm, moved=moved, per_frame=per_frame), change_of(scale=scale)
    change[1] *= 2
    images = ball.project(ball.clean + change)
    assert images.dtype == np.float32
    assert np.abs((images - levels(ball) / 255) - projected(ball, change)).max() < 1e-6
    assert ball.holds(images)


@pytest.mark.parametrize("moved", MOVED)
@pytest.mark.parametrize(("norm", "per_frame"), BALLS[:3])
def test_a_step_follows_the_gradient_or_its_sign(norm, per_frame, moved):
    ball, gradient = ball_of(norm=norm, moved=moved, per_frame=per_frame), change_of(3)
    gradient[0] *= 5
    gradient[:, 0] = 0
    start = ball.project(ball.clean + change_of(4, 0.01))
    pull = np.stack([gradient.sum(axis=0)] * 2).astype(np.float64) if moved == "joint" else gradient.astype(np.float64)
    if norm != "rms":
        direction = np.sign(pull)
    elif per_frame:
        direction = pull / np.sqrt((pull**2).mean(axis=(1, 2, 3), keepdims=True))
    else:
        direction = pull / rms(pull, moved, False)
    images = ball.step(start, gradient, 3)
    assert np.array_equal(ball.step(ball.clean, np.zeros_like(ball.clean), 3), ball.clean)
    change = start - levels(ball) / 255 + 3 / 255 * direction
    assert np.abs((images - levels(ball) / 255) - projected(ball, change)).max() < 1e-6


@pytest.mark.parametrize("moved", MOVED)
@pytest.mark.parametrize(("norm", "per_frame"), BALLS)
def test_a_random_pair_is_uniform_or_on_the_sphere(norm, per_frame, moved):
    ball = ball_of(norm=norm, moved=moved, per_frame=per_frame)
    if norm == "rms":
        change = Rng.of(7).normals(120).reshape(2, 3, 4, 5)
    else:
        change = (2 * Rng.of(7).uniforms(120) - 1).reshape(2, 3, 4, 5) * (10 / 255 if norm == "linf" else 1)
    if moved == "joint":
        change[1] = change[0]
    if norm == "rms":
        change *= 10 / 255 / rms(change, moved, per_frame)
    images = ball.random(Rng.of(7))
    assert np.abs((images - levels(ball) / 255) - projected(ball, change)).max() < 1e-6


def rounded(ball, change, factor):
    """The integer change of a pair whose change is scaled by a factor."""
    clean = levels(ball)
    if ball.moved == "joint":
        change = np.stack([(change[0] + change[1]) / 2] * 2)
        return np.clip(np.rint(change * 255 * factor), -np.minimum(*clean), 255 - np.maximum(*clean))
    return np.clip(np.rint(change * 255 * factor), -clean, 255 - clean)


@pytest.mark.parametrize("scale", [0.005, 0.1])
@pytest.mark.parametrize("moved", MOVED)
@pytest.mark.parametrize(("norm", "per_frame"), [("linf", False), ("rms", False), ("rms", True)])
@pytest.mark.parametrize("budget", [3.7, 10])
def test_rounded_frames_are_the_largest_ones_inside_the_budget(budget, norm, per_frame, moved, scale):
    ball, change = ball_of(budget, norm, moved, per_frame), change_of(scale=scale)
    for frame in {0, 1} - set(FRAMES[moved]):
        change[frame] = 0
    images = np.clip(ball.clean + change, 0, 1)
    change = images.astype(np.float64) - levels(ball) / 255
    if norm == "linf":
        expected = np.clip(rounded(ball, change, 1), -np.floor(budget), np.floor(budget))
    else:
        both = np.stack([change.mean(axis=0)] * 2) if moved == "joint" else change
        values = np.abs(both[both != 0]) * 255
        at = [(k + 0.5) / value for value in values for k in range(int(value) + 1)]  # where rounding changes
        factors = [1.0, *(factor - 1e-7 for factor in sorted(at, reverse=True) if factor < 1)]
        sizes = ((rms(rounded(ball, change, factor), moved, per_frame), factor) for factor in factors)
        expected = rounded(ball, change, next(factor for size, factor in sizes if size <= budget))
    assert np.array_equal(ball.to_8_bits(images), levels(ball) + expected)


def test_the_size_of_a_change_is_its_norm():
    change = np.zeros((2, 3, 4, 5), np.float32)
    change[0, 0, 0, 0], change[1, :, 1, 2], change[1, 2, 3, 3] = 4, -1, 2
    sizes = {norm: ball_of(norm=norm).size_of(change) for norm in ("linf", "rms", "area")}
    assert sizes == pytest.approx({"linf": 4, "rms": np.sqrt(23 / 120), "area": 10})
    assert ball_of(norm="rms", per_frame=True).size_of(change) == pytest.approx(np.sqrt(16 / 60))
    assert ball_of(norm="area", moved="first").size_of(change) == 5


def test_each_condition_of_a_ball_excludes_a_pair():
    ball = ball_of(10, moved="joint")
    same = np.zeros_like(ball.clean)
    inside = ball.project(ball.clean + 9 / 255)
    assert ball.holds(ball.clean)
    assert ball.holds(inside)
    same[0, 0, 0, 0] = 2 / 255 * (1 if ball.clean[0, 0, 0, 0] < 0.5 else -1)
    assert not ball.holds(ball.clean + same)  # the frames change differently
    for moved, frame in (("first", 1), ("second", 0)):
        still = ball_of(10, moved=moved)
        change = np.zeros_like(ball.clean)
        change[frame] = np.where(ball.clean[frame] < 0.5, 1e-3, -1e-3)
        assert not still.holds(still.clean + change)
        assert still.holds(still.clean + change[::-1] * 0)
    for outside in (-1e-3, 1 + 1e-3):
        pair = ball_of(10)
        images = pair.clean.copy()
        at = np.unravel_index((images if outside < 0 else -images).argmin(), images.shape)
        images[at] = outside
        assert pair.clean[at] == (outside > 0)
        assert not pair.holds(images)
    grey = Ball(*np.full((2, *SHAPE), 100, np.uint8), 10, "rms")
    assert grey.holds(grey.clean + np.float32(10 / 255))
    assert not grey.holds(grey.clean + np.float32(10.01 / 255))


@pytest.mark.parametrize(("norm", "most"), [("linf", 255), ("rms", 255), ("area", 100)])
def test_budget_outside_the_range_of_grey_levels_is_refused(norm, most):
    assert ball_of(most, norm).budget == most
    for wrong in (0, -1, most + 1, float("nan"), True, "8"):
        with pytest.raises(UsageError):
            ball_of(wrong, norm)
    for unknown in ({"norm": "l1"}, {"moved": "none"}):
        with pytest.raises(UsageError):
            ball_of(**unknown)


BUDGETS = {"linf": [1, 2, 4, 8, 16], "rms": [0.5, 1.25, 2.5, 5, 12.5], "area": [0.1, 0.5, 1, 2, 5]}


def test_every_attack_is_documented_and_has_the_severities_of_its_norm():
    for name in SHIPPED:
        attack = load_attack(name)
        assert isinstance(attack, Attack)
        assert attack.name == name
        assert type(attack).__doc__
        budgets = [attack.budget(severity) for severity in range(1, 6)]
        assert budgets == BUDGETS[attack.norm]

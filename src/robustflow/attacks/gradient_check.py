"""Check the gradient that a white-box attack is about to follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import ModelError
from ..models.base import model_identity
from ..random.rng import Rng
from ..sample import Flow
from .evaluation import Evaluation, evaluate
from .images import WHITE, Images
from .problem import Problem

_APART, _ROUNDING = 0.05, 0.01
"""Allowed mean distance between the flows of `predict` and `differentiable`: a share of the mean flow length, plus
pixels."""
_LENGTH = 0.25 / WHITE
"""Change of every value in the finite differences: a quarter of a grey level."""
_DIRECTIONS, _LEAST = 3, 4.0
"""Number of random directions, and how many times more than in any of them the loss must change along the gradient."""


def check_same_flow(model: object, differentiable: Flow, predicted: Flow, where: str) -> None:
    """Check that a model's `differentiable` computes the flow of its `predict`, both float32 (H, W, 2), in pixels."""
    usable = np.isfinite(predicted).all(axis=-1)
    if not usable.any():
        return
    lengths = np.linalg.norm(predicted[usable].astype(np.float64), axis=-1)
    apart = np.linalg.norm(differentiable[usable].astype(np.float64) - predicted[usable], axis=-1).mean()
    if not apart <= _APART * lengths.mean() + _ROUNDING:
        name = model_identity(model).get("name") or type(model).__name__
        raise ModelError(
            f"model '{name}' {where}: the flow of its method differentiable is {apart:.3g} px from the flow of predict "
            f"on average (mean length {lengths.mean():.3g} px); both must return the same flow"
        )


def check_gradient(problem: Problem, rng: Rng) -> None:
    """Compare the flows of `differentiable` and `predict` on the clean pair, and the change of the loss along the
    sign of the gradient with its change in random directions, at a random pair in the ball. The evaluations are
    not counted as the attack's.
    """
    asked = Evaluation(problem.model, problem.pair.key, images=problem.ball.clean)
    where = f"on the clean pair of '{problem.pair.key}'" if problem.pair.key else "on the clean pair"
    check_same_flow(problem.model, evaluate(asked).flow, problem.clean_flow, where)
    images = problem.ball.random(rng)
    answer = evaluate(replace(asked, images=images, loss=problem.loss))
    assert answer.gradient is not None
    if not (np.isfinite(answer.gradient).all() and answer.gradient.any()):
        return  # the attack itself reports this
    _, slope = problem.loss.slope(answer.flow)
    changes = []
    for direction in (np.sign(answer.gradient), *(_signs(rng, images) for _ in range(_DIRECTIONS))):
        nearby = np.clip(images + np.float32(_LENGTH) * direction, 0, 1).astype(np.float32)
        flow = evaluate(replace(asked, images=nearby)).flow
        changes.append(float((slope.astype(np.float64) * (flow - answer.flow)).sum()))
    if not changes[0] > _LEAST * max(map(abs, changes[1:])):
        problem.troubles.add("gradient_misleading")


def _signs(rng: Rng, images: Images) -> np.ndarray:
    return np.where(rng.bits(images.size) & np.uint64(1), 1, -1).reshape(images.shape)

"""Projected gradient ascent with a fixed step, shared by FGSM, BIM, PGD and CosPGD."""

from __future__ import annotations

from ..random.rng import Rng
from .images import Images
from .problem import Problem


def start_of(problem: Problem, rng: Rng, at_random: bool) -> Images:
    """Return the pair from which an attack starts: the clean pair, or a random pair in the ball.

    At the clean pair, the distance to the clean flow is zero and has no gradient, so attacks with this loss always
    start at a random pair.
    """
    return problem.ball.random(rng) if at_random or problem.from_clean else problem.ball.clean


def climb(problem: Problem, images: Images, steps: int, size: float, keep_best: bool) -> Images:
    """Run projected gradient ascent.

    Args:
        problem: the model, the ball and the loss.
        images: the starting point, inside the ball.
        steps: number of steps.
        size: step size, in grey levels of the ball's norm.
        keep_best: whether to return the best images so far instead of the last ones.
    """
    for _ in range(steps):
        _, gradient = problem.slope(images)
        images = problem.ball.step(images, gradient, size)
    problem.score(images)
    return problem.best if keep_best else images

"""PGD: steps along the sign of the gradient from random starts, projected into the ball (Madry et al. 2018)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..random.rng import Rng
from .base import Attack
from .images import WHITE, Images
from .problem import Problem

FLOWBENCH_STEP = 0.01 * WHITE
"""FlowBench's step size under "linf", in grey levels, for every budget."""


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


@dataclass(frozen=True, kw_only=True)
class Pgd(Attack):
    """Projected gradient ascent.

    The step size is 2.5 times the budget divided by the number of steps. The variant "flowbench" uses a step size of
    0.01 of the full range and returns the last pair instead of the best.

    Args:
        steps: number of gradients per start.
        starts: number of random starts; the best pair of all starts is returned.
    """

    name: ClassVar[str] = "pgd"
    variants: ClassVar[tuple[str, ...]] = ("default", "flowbench")

    steps: int = 20
    starts: int = 1

    at_random: ClassVar[bool] = True
    """Whether the attack starts at a random pair in the ball."""

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        images = problem.ball.clean
        for number in range(self.starts):
            start = start_of(problem, rng.spawn(number), self.at_random)
            size = self.step_size(problem.ball.budget)
            images = climb(problem, start, self.steps, size, keep_best=self.variant == "default")
        return images

    def step_size(self, budget: float) -> float:
        """The step size for a budget, both in grey levels."""
        return 2.5 * budget / self.steps if self.variant == "default" else FLOWBENCH_STEP

"""PGD: steps along the sign of the gradient from random starts, projected into the ball (Madry et al. 2018)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..random.rng import Rng
from .base import Attack
from .climb import climb, start_of
from .images import WHITE, Images
from .problem import Problem

FLOWBENCH_STEP = 0.01 * WHITE
"""FlowBench's step size under "linf", in grey levels, for every budget."""


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

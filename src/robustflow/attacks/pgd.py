"""PGD: steps along the sign of the gradient from random starts, projected into the ball (Madry et al. 2018)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from ..errors import UsageError
from ..random.rng import Rng
from .base import Attack
from .images import WHITE, Images
from .problem import Problem

FLOWBENCH_STEP = 0.01 * WHITE
"""FlowBench's step size under "linf", in grey levels, for every budget."""


def start_of(problem: Problem, rng: Rng, at_random: bool) -> Images:
    """Return the pair from which an attack starts: the clean pair, or a random pair in the ball."""
    return problem.ball.random(rng) if at_random or problem.from_clean else problem.ball.clean


def climb(problem: Problem, images: Images, sizes: Sequence[float], keep_best: bool) -> Images:
    """Run projected gradient ascent."""
    for size in sizes:
        _, gradient = problem.slope(images)
        images = problem.ball.step(images, gradient, size)
    problem.score(images)
    return problem.best if keep_best else images


@dataclass(frozen=True, kw_only=True)
class Pgd(Attack):
    """Projected gradient ascent."""

    name: ClassVar[str] = "pgd"
    variants: ClassVar[tuple[str, ...]] = ("default", "flowbench")

    steps: int = 20
    starts: int = 3
    step: float = 0.0

    at_random: ClassVar[bool] = True
    """Whether the attack starts at a random pair in the ball."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.step, int | float) or not 0 <= self.step <= 2:
            raise UsageError(f"step of attack {self.name} must be a fraction of the budget, 0 to 2, not {self.step!r}")
        if self.variant == "flowbench" and self.starts not in (1, type(self).starts):
            raise UsageError(
                f"attack {self.name} has a single start in the variant flowbench; omit starts={self.starts}"
            )

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        images = problem.ball.clean
        default = self.variant == "default"
        for number in range(self.starts if default else 1):
            problem.begin()
            start = start_of(problem, rng.spawn(number), self.at_random)
            images = climb(problem, start, self.step_sizes(problem.ball.budget), keep_best=default)
        return images

    def step_sizes(self, budget: float) -> list[float]:
        """The size of each step for a budget, both in grey levels."""
        if self.step:
            return [self.step * budget] * self.steps
        if self.variant == "flowbench":
            return [FLOWBENCH_STEP] * self.steps
        first = max(0.5, 4 / self.steps) * budget
        return [first * (1 - number / self.steps) for number in range(self.steps)]

"""Steps along the gradient, projected into the ball: FGSM (Goodfellow et al. 2015), BIM (Kurakin et al. 2017), PGD
(Madry et al. 2018), CosPGD (Agnihotri et al. 2024) and APGD (Croce and Hein 2020, as in AutoAttack).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.errors import UsageError
from ..core.rng import Rng
from .ball import WHITE, Images
from .base import Attack
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
    """Projected gradient ascent from random starts, with falling steps."""

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
            raise UsageError("step", f"must be a fraction of the budget of {self.name}, 0 to 2, not {self.step!r}")
        if self.variant == "flowbench" and self.starts not in (1, type(self).starts):
            raise UsageError("starts", f"{self.name} has a single start in the variant flowbench; omit it")

    def run(self, problem: Problem, rng: Rng) -> Images:
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


@dataclass(frozen=True, kw_only=True)
class Fgsm(Attack):
    """A single step of the full budget, from a random pair if the loss has no gradient at the clean one."""

    name: ClassVar[str] = "fgsm"
    above: ClassVar[str] = "fgsm_above_iterative"
    variants: ClassVar[tuple[str, ...]] = ("default", "flowbench")

    def run(self, problem: Problem, rng: Rng) -> Images:
        ball = problem.ball
        images = start_of(problem, rng, at_random=False)
        _, gradient = problem.slope(images)
        gradient = np.sign(gradient) if self.variant == "flowbench" else gradient
        return ball.step(images, gradient, ball.budget)


@dataclass(frozen=True, kw_only=True)
class Bim(Pgd):
    """Projected gradient ascent from the clean pair."""

    name: ClassVar[str] = "bim"
    at_random: ClassVar[bool] = False

    starts: int = 1

    def step_sizes(self, budget: float) -> list[float]:
        return [budget] * self.steps if self.variant == "flowbench" else super().step_sizes(budget)


@dataclass(frozen=True, kw_only=True)
class CosPgd(Pgd):
    """PGD in which a pixel's loss is weighted by the cosine of softmax(u, v) between the flow and the reference."""

    name: ClassVar[str] = "cospgd"
    agreeing: ClassVar[bool] = True


_MOMENTUM = 0.75
"""Weight of the projected step; the remaining weight applies to the previous step."""
_IMPROVED = 0.75
"""The step size is halved if at most this share of the steps since the last check raised the score."""
_FIRST, _SHORTER, _SHORTEST = 0.22, 0.03, 0.06
"""First interval between checks, its decrease after each, and its minimum, as shares of the number of steps."""


@dataclass(frozen=True, kw_only=True)
class Apgd(Attack):
    """Projected gradient ascent that halves its step and returns to the best pair when too few steps improve."""

    name: ClassVar[str] = "apgd"

    steps: int = 100
    starts: int = 3

    def run(self, problem: Problem, rng: Rng) -> Images:
        for number in range(self.starts):
            problem.begin()
            self._climb(problem, problem.ball.random(rng.spawn(number)))
        return problem.best

    def _climb(self, problem: Problem, images: Images) -> None:
        ball, size = problem.ball, 2 * problem.ball.budget
        score, gradient = problem.slope(images)
        before = images
        best, best_score, best_gradient = images, score, gradient
        pause, shortest = max(int(_FIRST * self.steps), 1), max(int(_SHORTEST * self.steps), 1)
        at_last_check, halved, since, improved = best_score, True, 0, 0
        for number in range(self.steps):
            stepped = ball.step(images, gradient, size)
            weight = _MOMENTUM if number else 1.0
            moved = ball.project(images + (stepped - images) * weight + (images - before) * (1 - weight))
            before, images = images, moved
            last, (score, gradient) = score, problem.slope(images)
            improved += score > last
            if score > best_score:
                best, best_score, best_gradient = images, score, gradient
            since += 1
            if since < pause:
                continue
            stuck = not halved and at_last_check >= best_score
            halved = improved <= _IMPROVED * since or stuck
            if halved:
                size /= 2
                images, gradient = best, best_gradient
            at_last_check, since, improved = best_score, 0, 0
            pause = max(pause - max(int(_SHORTER * self.steps), 1), shortest)

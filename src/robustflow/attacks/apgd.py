"""APGD: PGD with momentum and automatic step halving (Croce and Hein 2020, as in AutoAttack)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..random.rng import Rng
from .base import Attack
from .images import Images
from .problem import Problem

_MOMENTUM = 0.75
"""Weight of the projected step; the remaining weight applies to the previous step."""
_IMPROVED = 0.75
"""The step size is halved if fewer than this share of the steps since the last check raised the score."""
_FIRST, _SHORTER, _SHORTEST = 0.22, 0.03, 0.06
"""Interval before the first check, decrease of the interval after each check, and minimum interval, as fractions of the
number of steps."""


@dataclass(frozen=True, kw_only=True)
class Apgd(Attack):
    """Projected gradient ascent with an initial step size of twice the budget. If too few steps since the last check
    raised the score, or the best score did not improve, the step size is halved and the search resumes at the best
    pair.
    """

    name: ClassVar[str] = "apgd"

    steps: int = 100
    starts: int = 3

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
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

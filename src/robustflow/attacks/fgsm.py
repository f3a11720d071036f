"""FGSM: a single step of the full budget along the sign of the gradient (Goodfellow et al. 2015)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..random.rng import Rng
from .base import Attack
from .images import Images
from .pgd import start_of
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class Fgsm(Attack):
    """A single gradient step. If the loss is the distance to the clean flow, which has no gradient at the clean frames,
    the attack starts at a random pair.
    """

    name: ClassVar[str] = "fgsm"
    variants: ClassVar[tuple[str, ...]] = ("default", "flowbench")

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        ball = problem.ball
        images = start_of(problem, rng, at_random=False)
        _, gradient = problem.slope(images)
        gradient = np.sign(gradient) if self.variant == "flowbench" else gradient
        return ball.step(images, gradient, ball.budget)

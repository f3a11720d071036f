"""FGSM: one step of the whole budget along the sign of the gradient (Goodfellow et al. 2015)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..random.rng import Rng
from .base import Attack
from .climb import start_of
from .images import Images
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class Fgsm(Attack):
    """One gradient, one step. Against the clean flow, whose distance has no gradient at the clean frames, it starts at
    random.

    The variant "flowbench" takes the sign of the gradient under "rms", too, brought to the length of the budget.
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

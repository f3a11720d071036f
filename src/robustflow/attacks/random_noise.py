"""Controls: Gaussian noise with the whole budget, and values that change by the whole budget, up or down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.rng import Rng
from .ball import Images
from .base import Control
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class RandomGauss(Control):
    """Add Gaussian noise with the full "rms" budget, without querying the model."""

    name: ClassVar[str] = "random_gauss"
    norms: ClassVar[tuple[str, ...]] = ("rms",)

    norm: str = "rms"

    def run(self, problem: Problem, rng: Rng) -> Images:
        return problem.ball.random(rng)


@dataclass(frozen=True, kw_only=True)
class RandomSign(Control):
    """Add noise of random sign with the full "linf" budget, without querying the model."""

    name: ClassVar[str] = "random_sign"
    norms: ClassVar[tuple[str, ...]] = ("linf",)

    def run(self, problem: Problem, rng: Rng) -> Images:
        ball = problem.ball
        up = (rng.bits(ball.clean.size) & np.uint64(1)).astype(np.float32).reshape(ball.clean.shape)
        if ball.moved == "joint":
            up[1] = up[0]
        return ball.project(ball.clean + (2 * up - 1) * ball.radius)

"""Controls for attacks with the same norm: random noise and a patch of random colours, which do not query the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.rng import Rng
from .ball import Images
from .base import Attack
from .patch import Disc, diameter, paste
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class Control(Attack):
    """A control for attacks with the same norm: random noise, which does not query the model."""

    needs_gradients: ClassVar[bool] = False
    control: ClassVar[bool] = True


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


@dataclass(frozen=True, kw_only=True)
class RandomPatch(Control):
    """Fill a disc of the budget's area with random colours, without querying the model."""

    name: ClassVar[str] = "random_patch"
    norms: ClassVar[tuple[str, ...]] = ("area",)

    norm: str = "area"

    def run(self, problem: Problem, rng: Rng) -> Images:
        size = diameter(problem)
        colours = rng.uniforms(3 * size * size).astype(np.float32).reshape(3, size, size)
        return paste(problem, colours, Disc.of(problem, problem.pair.stream("patch")))

"""Control: Gaussian noise whose root mean square is the whole budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..random.rng import Rng
from .base import Attack
from .images import Images
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class RandomGauss(Attack):
    """Random noise with the norm of the attacks under "rms"; it asks the model nothing."""

    name: ClassVar[str] = "random_gauss"
    needs_gradients: ClassVar[bool] = False
    norms: ClassVar[tuple[str, ...]] = ("rms",)
    control: ClassVar[bool] = True

    norm: str = "rms"

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        return problem.ball.random(rng)

"""Control: Gaussian noise whose root mean square equals the budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..random.rng import Rng
from .base import Control
from .images import Images
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class RandomGauss(Control):
    """Add Gaussian noise with the full "rms" budget, without querying the model."""

    name: ClassVar[str] = "random_gauss"
    norms: ClassVar[tuple[str, ...]] = ("rms",)

    norm: str = "rms"

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        return problem.ball.random(rng)

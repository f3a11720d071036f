"""Control: a disc of random colours at the same position as in the attack `patch`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..random.rng import Rng
from .base import Control
from .images import Images
from .patch import Disc, diameter, paste
from .problem import Problem


@dataclass(frozen=True, kw_only=True)
class RandomPatch(Control):
    """Fill a disc of the budget's area with random colours, without querying the model."""

    name: ClassVar[str] = "random_patch"
    norms: ClassVar[tuple[str, ...]] = ("area",)

    norm: str = "area"

    def run(self, problem: Problem, rng: Rng) -> Images:
        """See `Attack.run`."""
        size = diameter(problem)
        colours = rng.uniforms(3 * size * size).astype(np.float32).reshape(3, size, size)
        return paste(problem, colours, Disc.of(problem, problem.pair.stream("patch")))

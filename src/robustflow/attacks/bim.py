"""BIM: PGD from the clean pair (Kurakin et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .pgd import Pgd


@dataclass(frozen=True, kw_only=True)
class Bim(Pgd):
    """Projected gradient ascent from the clean pair."""

    name: ClassVar[str] = "bim"
    at_random: ClassVar[bool] = False

    starts: int = 1

    def step_sizes(self, budget: float) -> list[float]:
        """See `Pgd.step_sizes`."""
        return [budget] * self.steps if self.variant == "flowbench" else super().step_sizes(budget)

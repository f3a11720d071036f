"""The arms of the experiment. All arms have the same network, initial weights, data and number of updates; they differ
in the corruptions of the training frames."""

from __future__ import annotations

from dataclasses import dataclass

from ..corruptions import FAMILIES, IMAGE_PAIR

TRAINED = ("digital", "illumination", "weather", "noise", "blur")
"""Corruption families for training frames; families for whole clips cannot be applied to a pair of images."""
LEFT_OUT = ("noise", "weather")
"""Families held out from training and used for evaluation: the two that increase the error the most."""
PLAIN, ALL = "plain", "all"


@dataclass(frozen=True)
class Arm:
    """One arm of the experiment."""

    name: str
    families: tuple[str, ...]

    @property
    def corruptions(self) -> list[str]:
        """Return the corruptions of the arm's families that can be applied to a pair of images."""
        return [name for family in self.families for name in members(family)]


def members(family: str) -> list[str]:
    """Return the corruptions of a family that can be applied to a pair of images."""
    return [name for name in FAMILIES[family] if name in IMAGE_PAIR]


def arms() -> list[Arm]:
    """Return the arms: one without corruptions, one with all families, and for each held-out family one with all
    families except that one.
    """
    without = [Arm(f"no_{left}", tuple(family for family in TRAINED if family != left)) for left in LEFT_OUT]
    return [Arm(PLAIN, ()), Arm(ALL, TRAINED), *without]


def measured() -> list[str]:
    """Return the corruptions under which every network is evaluated."""
    return [name for family in LEFT_OUT for name in members(family)]

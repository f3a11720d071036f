"""What is compared: the same network, start, data and number of updates, with different corruptions on the training
frames."""

from __future__ import annotations

from dataclasses import dataclass

from ..corruptions import FAMILIES, IMAGE_PAIR

TRAINED = ("digital", "illumination", "weather", "noise", "blur")
"""Families that training frames can have; those of whole clips cannot be applied to a pair of images."""
LEFT_OUT = ("noise", "weather")
"""Families that an arm is trained without and measured under: the two under which errors grow most."""
PLAIN, ALL = "plain", "all"


@dataclass(frozen=True)
class Arm:
    """A way of training.

    Attributes:
        name: "plain", "all", or "no_FAMILY".
        families: whose corruptions are applied to the training frames.
    """

    name: str
    families: tuple[str, ...]

    @property
    def corruptions(self) -> list[str]:
        """The corruptions of its families that can be applied to a pair of images."""
        return [name for family in self.families for name in members(family)]


def members(family: str) -> list[str]:
    """The corruptions of a family that can be applied to a pair of images.

    >>> members("noise")
    ['gaussian_noise', 'shot_noise', 'impulse_noise']
    """
    return [name for name in FAMILIES[family] if name in IMAGE_PAIR]


def arms() -> list[Arm]:
    """The arms: without corruptions, with all, and with all families but one.

    >>> [arm.name for arm in arms()]
    ['plain', 'all', 'no_noise', 'no_weather']
    """
    without = [Arm(f"no_{left}", tuple(family for family in TRAINED if family != left)) for left in LEFT_OUT]
    return [Arm(PLAIN, ()), Arm(ALL, TRAINED), *without]


def measured() -> list[str]:
    """The corruptions that every network is measured under.

    >>> len(measured())
    7
    """
    return [name for family in LEFT_OUT for name in members(family)]

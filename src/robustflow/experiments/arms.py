"""What is compared: the same network, start, data and number of updates, with different corruptions on the training
frames."""

from __future__ import annotations

from dataclasses import dataclass

from ..corruptions import FAMILIES, IMAGE_PAIR

TESTED = ("digital", "illumination", "weather", "noise", "blur")
"""Families that are left out one at a time; those of whole clips cannot be applied to a pair of images."""
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
    """Without corruptions, with all, and with all families but one.

    >>> [arm.name for arm in arms()]
    ['plain', 'all', 'no_digital', 'no_illumination', 'no_weather', 'no_noise', 'no_blur']
    """
    without = [Arm(f"no_{left}", tuple(family for family in TESTED if family != left)) for left in TESTED]
    return [Arm(PLAIN, ()), Arm(ALL, TESTED), *without]

"""Corruptions that exist only as files: the frames of a data set that is distributed corrupted, under names of its own.

A row tells a corruption by its name alone, and RobustSpring's `fog` is not this project's: the program that made it,
its strength and its consistency in time and depth are others. So each gets a name of its own here, the data set's and
its own joined by "_": `robustspring_fog`. That is a name like any other, which may stand in the name of a file, an
address, a table of LaTeX and a CSV file; ":" and "+" would mean a severity and a stack, "/" a folder. It is never
computed: `load_corruption` refuses it, and only a benchmark whose frames come with it can run it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import UsageError


@dataclass(frozen=True)
class OnDisk:
    """The corruptions of one such data set, each at a single strength.

    Attributes:
        dataset: its name, with which the names here begin.
        title: its authors' name for it.
        abbreviation: of the title, for headings of columns.
        families: family of this project -> its own names for its corruptions.

    >>> ROBUSTSPRING.here("fog"), ROBUSTSPRING.there("robustspring_fog"), len(ROBUSTSPRING.names)
    ('robustspring_fog', 'fog', 20)
    """

    dataset: str
    title: str
    abbreviation: str
    families: Mapping[str, tuple[str, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its corruptions here, family by family."""
        return tuple(self.here(own) for names in self.families.values() for own in names)

    def here(self, own: str) -> str:
        """The name here of one of its corruptions."""
        return f"{self.dataset}_{own}"

    def there(self, name: str) -> str:
        """Its own name for one of `names`."""
        return name.removeprefix(f"{self.dataset}_")


ROBUSTSPRING = OnDisk(
    "robustspring",
    "RobustSpring",
    "RS",
    {
        "digital": ("jpeg_compression", "pixelate", "elastic_transform", "contrast", "saturate"),
        "illumination": ("brightness",),
        "weather": ("spatter", "fog", "frost", "snow", "rain"),
        "noise": ("gaussian_noise", "shot_noise", "impulse_noise", "speckle_noise"),
        "blur": ("gaussian_blur", "defocus_blur", "glass_blur", "motion_blur", "zoom_blur"),
    },
)
"""Schmalfuss et al., RobustSpring, arXiv 2505.09368, whose weather, noise and blur hold the same corruptions; its
"color" is brightness, contrast and saturate, its "quality" pixelate, jpeg_compression and elastic_transform."""

SETS: tuple[OnDisk, ...] = (ROBUSTSPRING,)
_SET_OF = {name: each for each in SETS for name in each.names}


def on_disk(name: str) -> OnDisk | None:
    """The data set that a corruption comes with; None for one that is computed, and for an unknown name.

    >>> on_disk("robustspring_rain") is ROBUSTSPRING, on_disk("rain"), on_disk("fog")
    (True, None, None)
    """
    return _SET_OF.get(name)


def refuse_on_disk(name: str) -> None:
    """Raise a UsageError for a corruption that cannot be computed."""
    if (files := on_disk(name)) is not None:
        raise UsageError(
            f"'{name}' exists only as the files of {files.title}, so no other frames can be corrupted with it; "
            f"run --benchmark {files.dataset} --data FOLDER"
        )

"""Corruptions that exist only as files: the frames of a data set that is distributed corrupted.

Rows identify corruptions by name, and RobustSpring's `fog` is not this project's: it was made by another program, with
another strength and consistency in time and depth. So each gets a local name, the data set's name and the corruption's
joined by "_": `robustspring_fog`. Such a name can be part of a file name, an address, a LaTeX table and a CSV file; ":"
and "+" would mean a severity and a stack, "/" a folder. `load_corruption` refuses it, and only a benchmark that has the
corrupted frames can run it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import UsageError


@dataclass(frozen=True)
class OnDisk:
    """The corruptions of one such data set, each at a single strength.

    Attributes:
        dataset: its name, the prefix of the local names.
        title: its authors' name for it.
        abbreviation: of the title, for headings of columns.
        families: family of this project -> the data set's names of its corruptions.

    >>> ROBUSTSPRING.local_name("fog"), ROBUSTSPRING.dataset_name("robustspring_fog"), len(ROBUSTSPRING.names)
    ('robustspring_fog', 'fog', 20)
    """

    dataset: str
    title: str
    abbreviation: str
    families: Mapping[str, tuple[str, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        """The local names of its corruptions, family by family."""
        return tuple(self.local_name(name) for names in self.families.values() for name in names)

    def local_name(self, dataset_name: str) -> str:
        """The name in this project of one of its corruptions."""
        return f"{self.dataset}_{dataset_name}"

    def dataset_name(self, name: str) -> str:
        """The data set's name for one of `names`."""
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

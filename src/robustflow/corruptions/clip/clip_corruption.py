"""Placeholders for clip corruptions where only images are available: they provide names and parameters, but applying
them raises an error.
"""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

from ...errors import UsageError
from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..registry import BETWEEN_FRAMES


class ClipCorruption(Corruption):
    """A deterministic corruption of a clip, which cannot be applied to two images.

    A dataset with clips (`robustflow.datasets.gopro_fc_prepared`) provides frames that are already corrupted.
    """

    temporal = True
    instead: ClassVar[str] = ""
    """Alternative to a clip, appended to error messages; empty if there is none."""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoReturn:
        """Raise an error because there is no clip."""
        shows = "" if self.name in BETWEEN_FRAMES else ", and robustflow gallery --clip CLIP shows it"
        raise UsageError(
            f"{self.name} requires the clip that contains the frames, not two images; robustflow run --benchmark "
            f"gopro-fc --data CLIP evaluates the corruption{shows}{self.instead}"
        )

    def apply(self, frame: Frame, state: Any, index: int) -> NoReturn:
        """Raise an error, like `draw`."""
        raise UsageError(f"{self.name} requires the clip that contains the frame, not one image")

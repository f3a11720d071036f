"""A corruption of a whole clip, for code that only has images: a name, five numbers, and an error."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

from ...errors import UsageError
from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from ..registry import BETWEEN_FRAMES


class ClipCorruption(Corruption):
    """A corruption of a clip. Nothing in it is random, and two images are not enough for it.

    A dataset that holds the clips (`robustflow.datasets.gopro_fc_prepared`) gives its frames already corrupted.
    """

    temporal: ClassVar[bool] = True

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoReturn:
        """Refuse, because there is no clip.

        Raises:
            UsageError: always.
        """
        shows = "" if self.name in BETWEEN_FRAMES else ", robustflow gallery --clip CLIP shows it"
        raise UsageError(
            f"{self.name} needs the clip that the frames come from, not two images; robustflow run --benchmark "
            f"gopro-fc --data CLIP measures it{shows}"
        )

    def apply(self, frame: Frame, state: Any, index: int) -> NoReturn:
        """Refuse, like `draw`."""
        raise UsageError(f"{self.name} needs the clip that the frames come from, not one image")

"""The four corruptions that need the whole clip around a pair: names and numbers; `robustflow.video` does the work."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

from ..errors import UsageError
from ..random.rng import Rng
from ..sample import Frame
from .base import Corruption


class ClipCorruption(Corruption):
    """A corruption of a clip. Nothing in it is random, and two images are not enough for it.

    A dataset that holds the clips (`robustflow.datasets.gopro_fc.GoProFC`) gives its frames already corrupted.
    """

    temporal: ClassVar[bool] = True

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoReturn:
        """Refuse: there is no clip here.

        Raises:
            UsageError: always.
        """
        raise UsageError(
            f"{self.name} needs the clip that the frames come from, not two images; "
            "use the benchmark gopro-fc (robustflow prepare gopro-fc, then run --benchmark gopro-fc)"
        )

    def apply(self, frame: Frame, state: Any, index: int) -> NoReturn:
        """Refuse, as `draw`."""
        raise UsageError(f"{self.name} needs the clip that the frames come from, not one image")


class ObjectMotionBlur(ClipCorruption):
    """The mean of the 2c + 1 master frames around a key frame (appendix, "Object Motion Blur"); parameter c."""

    name = "object_motion_blur"
    family = "blur"
    paper_severities = (3, 6, 9, 12, 15)


class H264Crf(ClipCorruption):
    """H.264 at a constant rate factor (appendix, "H.264 CRF"); parameter CRF."""

    name = "h264_crf"
    family = "video"
    paper_severities = (23, 30, 37, 44, 51)


class H264Abr(ClipCorruption):
    """H.264 at an average bit rate (appendix, "H.264 ABR"); parameter bit/s, also maxrate and bufsize."""

    name = "h264_abr"
    family = "video"
    paper_severities = (25_000_000, 12_500_000, 6_250_000, 3_125_000, 1_562_500)


class BitError(ClipCorruption):
    """Bytes of the lossless clip overwritten (appendix, "Bit Error"); parameter N of FFmpeg's noise filter.

    The reference code's severity 5 is 5 M where the paper says 1 M.
    """

    name = "bit_error"
    family = "video"
    paper_severities = (50_000_000, 25_000_000, 15_000_000, 10_000_000, 1_000_000)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        """The reference's numbers for the variant "reference", the paper's otherwise."""
        if variant == "reference":
            return (*self.paper_severities[:4], 5_000_000)
        return self.paper_severities

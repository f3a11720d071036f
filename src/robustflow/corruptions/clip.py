"""Names and parameters of the corruptions of whole clips; without the clip, applying them raises an error."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

from ..core.errors import UsageError
from ..core.rng import Rng
from ..core.types import Frame
from .corruption import Corruption
from .registry import BETWEEN_FRAMES


class ClipCorruption(Corruption):
    """A deterministic corruption of a clip, which cannot be applied to two images.

    A dataset with clips (`robustflow.data.datasets.gopro_fc`) provides frames that are already corrupted.
    """

    temporal = True
    instead: ClassVar[str] = ""
    """Alternative to a clip, appended to error messages; empty if there is none."""

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> NoReturn:
        shows = "" if self.name in BETWEEN_FRAMES else ", and robustflow gallery --clip CLIP shows it"
        raise UsageError(
            self.name,
            "requires the clip that contains the frames, not two images; robustflow run --benchmark "
            f"gopro-fc --data CLIP evaluates the corruption{shows}{self.instead}",
        )

    def apply(self, frame: Frame, state: Any, index: int) -> NoReturn:
        raise UsageError(self.name, "requires the clip that contains the frame, not one image")


class H264Crf(ClipCorruption):
    """Compresses the clip with H.264 at a constant rate factor (appendix, "H.264 CRF"); the parameter is the CRF."""

    name = "h264_crf"
    paper_severities = (23, 30, 37, 44, 51)


class H264Abr(ClipCorruption):
    """Compresses the clip with H.264 at an average bit rate (appendix, "H.264 ABR").

    The parameter is the bit rate in bit/s, which is also used for maxrate and bufsize.
    """

    name = "h264_abr"
    paper_severities = (25_000_000, 12_500_000, 6_250_000, 3_125_000, 1_562_500)


class BitError(ClipCorruption):
    """Overwrites bytes in the losslessly compressed clip (appendix, "Bit Error").

    The parameter is N in FFmpeg's noise filter. At severity 5, the reference code uses 5 million, whereas the
    paper states 1 million.
    """

    name = "bit_error"
    paper_severities = (50_000_000, 25_000_000, 15_000_000, 10_000_000, 1_000_000)

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        if variant == "reference":
            return (*self.paper_severities[:4], 5_000_000)
        return self.paper_severities


class ObjectMotionBlur(ClipCorruption):
    """Averages 2c + 1 master frames centred on a key frame (appendix, "Object Motion Blur"); the parameter is c."""

    name = "object_motion_blur"
    paper_severities = (3, 6, 9, 12, 15)


class RollingShutter(ClipCorruption):
    """Copies each row of a key frame from the master frame at the row's readout time.

    The parameter is the total readout time in master frames, equivalent to 6 to 31 ms at 960 frames per second. Row y
    of the H rows is copied from the master frame nearest to readout ((y + 1/2) / H - 1/2) frames after the key frame.
    A rolling shutter changes the true flow, so errors relative to the ground truth are meaningless, and only RCRE is
    measured. This corruption is excluded from the paper's averages.
    """

    name = "rolling_shutter"
    truth = "none"
    paper_severities = (6, 12, 18, 24, 30)
    instead = (
        "; for pairs with exact ground truth, use --benchmark shapes --data-option readout=0.6 instead of the "
        "corruption"
    )

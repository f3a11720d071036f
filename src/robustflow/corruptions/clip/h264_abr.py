"""Compress with H.264 at an average bit rate."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class H264Abr(ClipCorruption):
    """Compresses the clip with H.264 at an average bit rate (appendix, "H.264 ABR").

    The parameter is the bit rate in bit/s, which is also used for maxrate and bufsize.
    """

    name = "h264_abr"
    family = "video"
    paper_severities = (25_000_000, 12_500_000, 6_250_000, 3_125_000, 1_562_500)

"""Compress with H.264 at a constant rate factor."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class H264Crf(ClipCorruption):
    """Compresses the clip with H.264 at a constant rate factor (appendix, "H.264 CRF"); the parameter is the CRF."""

    name = "h264_crf"
    family = "video"
    paper_severities = (23, 30, 37, 44, 51)

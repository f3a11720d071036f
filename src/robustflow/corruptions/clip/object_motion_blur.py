"""Apply object motion blur."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class ObjectMotionBlur(ClipCorruption):
    """Averages 2c + 1 master frames centred on a key frame (appendix, "Object Motion Blur"); the parameter is c."""

    name = "object_motion_blur"
    family = "blur"
    paper_severities = (3, 6, 9, 12, 15)

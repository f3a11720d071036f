"""Simulate a rolling shutter."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class RollingShutter(ClipCorruption):
    """Takes each row of a key frame from the master frame at the row's readout time; the parameter is the total readout
    time in master frames, 6 to 31 ms at 960 frames per second.

    Row y of H comes from the master frame nearest to readout ((y + 1/2) / H - 1/2) after the key frame. Rolling shutter
    changes the true flow, so errors against ground truth are meaningless and only RCRE is measured. Excluded from the
    paper's averages.
    """

    name = "rolling_shutter"
    family = "sensor"
    paper_severities = (6, 12, 18, 24, 30)

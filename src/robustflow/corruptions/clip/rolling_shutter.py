"""Simulate a rolling shutter."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class RollingShutter(ClipCorruption):
    """Copies each row of a key frame from the master frame at the row's readout time.

    The parameter is the total readout time in master frames, equivalent to 6 to 31 ms at 960 frames per second. Row y
    of the H rows is copied from the master frame nearest to readout ((y + 1/2) / H - 1/2) frames after the key frame.
    A rolling shutter changes the true flow, so errors relative to the ground truth are meaningless, and only RCRE is
    measured. This corruption is excluded from the paper's averages.
    """

    name = "rolling_shutter"
    family = "sensor"
    truth = "none"
    paper_severities = (6, 12, 18, 24, 30)
    instead = (
        "; for pairs with exact ground truth, use --benchmark shapes --data-option readout=0.6 instead of the "
        "corruption"
    )

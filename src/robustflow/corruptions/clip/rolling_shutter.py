"""Rolling shutter."""

from __future__ import annotations

from .clip_corruption import ClipCorruption


class RollingShutter(ClipCorruption):
    """Reads the rows of a key frame one after the other, each from the master frame of its time; parameter the readout
    time in master frames, 6 to 31 ms at 960 frames per second.

    Row y of H comes from the master frame nearest to readout ((y + 1/2) / H - 1/2) after the key frame. It changes the
    true flow, so errors against ground truth mean nothing: only RCRE is measured. In none of the paper's averages.
    """

    name = "rolling_shutter"
    family = "sensor"
    paper_severities = (6, 12, 18, 24, 30)

"""Underexpose one frame of a pair."""

from __future__ import annotations

from .over_exposure import OverExposure


class UnderExposure(OverExposure):
    """Like `OverExposure`, with negative ev (paper, "Under Exposure")."""

    name = "under_exposure"
    paper_severities = (-0.4, -0.8, -1.2, -1.6, -2.0)

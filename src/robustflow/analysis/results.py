"""Names of the metrics and conditions of result values."""

from __future__ import annotations

from ..metrics.rows import CLEAN

__all__ = ["AVERAGE", "CLEAN", "RESULT_METRICS"]

AVERAGE = "average"
RESULT_METRICS = ("epe", "cre", "rcre", "crer")
"""Metrics of results, in pixels except the last, which has no unit."""

"""Metrics: from flows to sums, and from sums to rows; `robustflow.runs.aggregate` computes means from rows."""

from .epe import epe_map, mean_epe
from .regions import REGIONS, Regions
from .robustness import cre, crer, rcre
from .rows import CLEAN, ROW_KEY, ROW_SCHEMA, ROW_SCHEMA_VERSION, measure, rows_frame
from .summary import METRICS, Averaging, CorruptionScores, RegionScores, Scores, Summary

__all__ = [
    "CLEAN",
    "METRICS",
    "REGIONS",
    "ROW_KEY",
    "ROW_SCHEMA",
    "ROW_SCHEMA_VERSION",
    "Averaging",
    "CorruptionScores",
    "RegionScores",
    "Regions",
    "Scores",
    "Summary",
    "cre",
    "crer",
    "epe_map",
    "mean_epe",
    "measure",
    "rcre",
    "rows_frame",
]

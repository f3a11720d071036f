"""Compute error sums from flows, and rows from these sums; `robustflow.run.aggregate` computes means from the rows."""

from .confidence import Sparsification, ause, confidence_correlation, error_at, forward_backward, sparsification
from .error_maps import cre, crer, epe_map
from .of_arrays import epe, fl_all, rcre
from .regions import REGIONS, Regions
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
    "Sparsification",
    "Summary",
    "ause",
    "confidence_correlation",
    "cre",
    "crer",
    "epe",
    "epe_map",
    "error_at",
    "fl_all",
    "forward_backward",
    "measure",
    "rcre",
    "rows_frame",
    "sparsification",
]

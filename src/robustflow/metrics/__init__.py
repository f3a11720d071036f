"""Sums of one image, rows of these sums, and means over rows; `measures` declares every measure."""

from .confidence import Sparsification, ause, confidence_correlation, error_at, forward_backward, sparsification
from .cube import Cube
from .error_maps import cre, crer, epe_map
from .measures import MEASURES, METRICS, Average, Increase, Measure, Ratio
from .of_arrays import epe, fl_all, rcre
from .regions import REGIONS, Regions
from .rows import CLEAN, ROW_KEY, ROW_SCHEMA, ROW_SCHEMA_VERSION, measure, rows_frame

__all__ = [
    "CLEAN",
    "MEASURES",
    "METRICS",
    "REGIONS",
    "ROW_KEY",
    "ROW_SCHEMA",
    "ROW_SCHEMA_VERSION",
    "Average",
    "Cube",
    "Increase",
    "Measure",
    "Ratio",
    "Regions",
    "Sparsification",
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

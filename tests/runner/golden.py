"""The golden run: rows of the demo pair for a flow that depends on no library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

import robustflow as rf
from robustflow.corruptions import IMAGE_PAIR

GOLDEN = Path(__file__).parent / "golden_rows.csv"
# it downloads its photographs, so it has a separate test
CORRUPTIONS = [name for name in IMAGE_PAIR if name != "frost"]
COLUMNS = ["corruption", "severity", "frames_digest", "n_all", "n_valid", "epe_sum", "rcre_sum", "fl_count", "wauc_sum"]
COLUMNS += ["n_photometric", "photometric_sum"]


def brightness_flow(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A flow that depends on every pixel of both frames, computed with integer arithmetic only."""
    u = -(frame1.astype(np.int32).sum(axis=2) // 8)
    v = (frame2.astype(np.int32).sum(axis=2) - frame1.astype(np.int32).sum(axis=2)) // 16
    return np.stack([u, v], axis=2).astype(np.float32)


def rows(folder: Path) -> pl.DataFrame:
    """The rows of a run, restricted to the stored columns."""
    result = rf.evaluate(brightness_flow, "demo", output=folder, corruptions=CORRUPTIONS, severities=[3])
    return result.rows.select(COLUMNS)

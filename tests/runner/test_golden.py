"""Compare a small run with stored rows, to detect any change in the bytes of a corruption or the digits of a metric.

The flow does not depend on any library. After a deliberate change, increment STREAM_VERSION or ROW_SCHEMA_VERSION and
rewrite the file with `python -m tests.runner.test_golden`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

import robustflow as rf
from robustflow.corruptions import IMAGE_PAIR

GOLDEN = Path(__file__).parent / "golden_rows.csv"
# it downloads its photographs, so it has a separate test
CORRUPTIONS = [name for name in IMAGE_PAIR if name != "frost"]
COLUMNS = ["corruption", "severity", "frames_digest", "n_all", "n_valid", "epe_sum", "rcre_sum", "fl_count", "wauc_sum"]


def brightness_flow(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A flow that depends on every pixel of both frames, computed with integer arithmetic only."""
    u = -(frame1.astype(np.int32).sum(axis=2) // 8)
    v = (frame2.astype(np.int32).sum(axis=2) - frame1.astype(np.int32).sum(axis=2)) // 16
    return np.stack([u, v], axis=2).astype(np.float32)


def rows(folder: Path) -> pl.DataFrame:
    """The rows of a run, restricted to the stored columns."""
    result = rf.evaluate(brightness_flow, "demo", output=folder, corruptions=CORRUPTIONS, severities=[3])
    return result.rows.select(COLUMNS)


def test_rows_are_those_of_the_golden_run(tmp_path):
    found = rows(tmp_path / "run")
    golden = pl.read_csv(GOLDEN, schema=found.schema)
    differing = [a[0] for a, b in zip(found.iter_rows(), golden.iter_rows(), strict=True) if a != b]
    assert not differing


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        rows(Path(scratch) / "run").write_csv(GOLDEN)
    sys.stdout.write(f"{GOLDEN}\n")

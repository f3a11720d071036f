"""Measured rows satisfy every rule, for any model; `test_verify` has forged rows that break one."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.core.types import Sample
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import measure, rows_frame
from robustflow.run.records.row_rules import check_rules

from ...refusals import refusal


def _random_rows(seed: int, scale: float, *, truth: bool, occlusion: bool, holes: float) -> pl.DataFrame:
    """Rows of one sample with random ground truth and random predictions, some of which are not finite."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 30, 2)
    frame = np.zeros((height, width, 3), np.uint8)

    def field(size: float) -> np.ndarray:
        return rng.normal(0, size, (height, width, 2)).astype(np.float32)

    def predicted(size: float) -> np.ndarray:
        flow = field(size)
        flow[rng.random((height, width)) < holes] = np.nan
        return flow

    flow = field(scale) if truth else None
    valid = rng.random((height, width)) < 0.8 if truth else None
    if valid is not None:
        valid[0, 0] = True
    occluded = rng.random((height, width)) < 0.3 if truth and occlusion else None
    sample = Sample("s", (frame, frame), flow, valid, occluded)
    regions = Regions.of(sample)
    near = 0 if flow is None else flow
    clean = (near + predicted(rng.choice([0.0, 0.5, 40.0]))).astype(np.float32)
    rows = [measure(clean, clean, sample, regions)]
    for severity in (1, 2, 3):
        moved = clean + predicted(rng.choice([0.0, 0.1, 5.0, 200.0]))
        rows.append(measure(moved, clean, sample, regions, corruption="fog", severity=severity))
    return rows_frame(rows).with_columns(frames_digest=pl.lit("ab" * 16))


@settings(max_examples=40)
@given(
    st.integers(0, 2**32),
    st.sampled_from([0.1, 3.0, 12.0, 60.0]),
    st.booleans(),
    st.booleans(),
    st.sampled_from([0.0, 0.0, 0.2, 1.0]),
)
def test_measured_rows_break_no_rule(seed, scale, truth, occlusion, holes):
    rows = _random_rows(seed, scale, truth=truth, occlusion=occlusion, holes=holes)
    check_rules(rows)


WHOLE = _random_rows(0, 20.0, truth=True, occlusion=True, holes=0.0)


@pytest.mark.parametrize(
    "change",
    [
        {"epe_sum_occ": pl.lit(None, pl.Float64)},
        {"photometric_sum": 255.0 * pl.col("n_photometric") + 1},
        {"wauc_sum": pl.col("n_valid") + 1.0},
        {"rejected_count": pl.col("n_all") + 1},
        {"fl_count_s0_10": pl.col("n_s0_10") + 1},
    ],
)
def test_sum_without_its_count_and_mean_beyond_its_unit_are_refused(change):
    ((name, value),) = change.items()
    changed = WHOLE.with_columns(pl.when(severity=2).then(value).otherwise(name).alias(name))
    refusal(lambda: check_rules(changed), DataError, "sample 's', fog severity 2")

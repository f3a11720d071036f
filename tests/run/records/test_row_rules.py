"""Measured rows satisfy every rule, for any model; each rule detects the change that it is meant to detect."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.types import Sample
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import ROW_KEY, measure, rows_frame
from robustflow.run.records.row_rules import RULES, broken_rules


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
    return rows_frame(rows)


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
    for reason, broken in broken_rules(rows):
        assert broken.is_empty(), f"{reason}: {broken.select(ROW_KEY).rows()}"


@pytest.fixture(scope="module")
def measured_rows() -> pl.DataFrame:
    return pl.concat(
        _random_rows(seed, 20.0, truth=True, occlusion=True, holes=0.0).with_columns(sample=pl.lit(str(seed)))
        for seed in range(4)
    )


_CLEAN = {
    "the clean frames have a spread, although they involve no randomness": {"spread_sum": pl.lit(1e-300)},
    "the flow on the clean frames differs from the clean flow": {"rcre_all_sum": pl.lit(1e-300)},
}
_GREATER = pl.col("epe_sum") + 2 * pl.col("rcre_sum") + 1
_FOG = {
    "its clean error differs from that of the sample's clean row": {
        "clean_epe_sum": pl.col("clean_epe_sum") * (1 + 1e-12)
    },
    "the error changed by more than the flow itself over the same pixels": {"clean_epe_sum": _GREATER},
    "its errors do not match what its corruption leaves of the ground truth": {"truth": pl.lit("none")},
    "its sums are negative or not finite": {"rcre_all_sum": pl.lit(float("nan"))},
    "it has more outliers than pixels": {"fl_count_occ": pl.col("n_occ") + 1},
    "the error changed by more than the flow itself": {"epe_sum": _GREATER},
    "the flow's length changed by more than the flow itself": {
        "pred_magnitude_sum": pl.col("pred_magnitude_sum") + 3 * pl.col("rcre_all_sum") + 1
    },
    "it counts more pixels than the frame has": {"n_invalid": pl.lit(1, pl.Int64)},
    "some of the values that are always measured together are missing": {"epe_sum_occ": pl.lit(None, pl.Float64)},
    "the values of its regions do not add up to those of all pixels": {
        "epe_sum_s40": pl.col("epe_sum_s40") * (1 + 1e-6)
    },
    "its counts of 1, 3 and 5 px outliers are inconsistent": {"px5_count": pl.col("px3_count") + 1},
    "its error is smaller than its outliers alone imply": {"epe_sum": pl.col("epe_sum") * 0.01},
    "the length of its ground-truth flow does not match its regions": {
        "magnitude_sum": 10.0 * pl.col("n_s10_40") + 40.0 * pl.col("n_s40") - 1
    },
    "its flow is too short for an error this small": {
        "pred_magnitude_sum": pl.lit(0.0),
        "epe_sum": 0.9 * pl.col("magnitude_sum"),
    },
    "the flow changed more on valid pixels than on all pixels": {"rcre_sum": pl.col("rcre_all_sum") + 1e-3},
    "its photometric error exceeds the range of grey levels": {"photometric_sum": 255.0 * pl.col("n_photometric") + 1},
    "it has attack values but is not an attack": {"attack_linf": pl.lit(1.0)},
    "its confidence ranks errors better than the oracle": {"error_at_80": pl.lit(1.0), "oracle_at_80": pl.lit(1.1)},
    "its size or group differs from that of the sample's other rows": {"group": pl.lit("other")},
    "its ground truth differs from that of the sample's other rows": {
        "magnitude_sum": pl.col("magnitude_sum") * (1 + 1e-12)
    },
}


@pytest.mark.parametrize("reason", RULES)
def test_each_rule_rejects_its_planted_change(reason, measured_rows):
    of_row = {"corruption": "clean", "severity": 0} if reason in _CLEAN else {"corruption": "fog", "severity": 2}
    where = pl.all_horizontal(pl.col(name) == value for name, value in {"sample": "2", **of_row}.items())
    change = (_CLEAN | _FOG)[reason]
    changed = measured_rows.with_columns(
        pl.when(where).then(change[name]).otherwise(name).alias(name) for name in change
    )
    broken = dict(broken_rules(changed))[reason]
    assert changed.filter(where).select(ROW_KEY).row(0) in broken.select(ROW_KEY).rows()
    assert dict(broken_rules(measured_rows))[reason].is_empty()

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
from robustflow.run.records.row_rules import broken_rules, row_rules


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
    for reason, broken in broken_rules(rows, row_rules()):
        assert broken.is_empty(), f"{reason}: {broken.select(ROW_KEY).rows()}"


@pytest.fixture(scope="module")
def measured_rows() -> pl.DataFrame:
    return pl.concat(
        _random_rows(seed, 20.0, truth=True, occlusion=True, holes=0.0).with_columns(sample=pl.lit(str(seed)))
        for seed in range(4)
    )


_TOGETHER, _RANGE = "sums and their counts are measured together", "no mean is beyond the range of its unit"
_PIXELS, _TRUTH = "a frame has its pixels", "errors exist if the corruption leaves the ground truth"
_SAMPLE, _CLEAN = "rows of a sample have one size, group and ground truth", "clean errors are those of the clean row"
_NO_ATTACK = "only attacks have values of attacks, and all of them"
_CHANGES = [
    (_TOGETHER, {"epe_sum_occ": pl.lit(None, pl.Float64)}),
    (_RANGE, {"photometric_sum": 255.0 * pl.col("n_photometric") + 1}),
    (_RANGE, {"wauc_sum": pl.col("n_valid") + 1.0}),
    (_RANGE, {"rejected_count": pl.col("n_all") + 1}),
    (_RANGE, {"fl_count_s0_10": pl.col("n_s0_10") + 1}),
    (_PIXELS, {"n_invalid": pl.lit(1, pl.Int64)}),
    (_PIXELS, {"n_photometric": pl.col("height") * pl.col("width") + 1}),
    (_PIXELS, {"n_truth": pl.col("height") * pl.col("width") + 1}),
    (_PIXELS, {"n_valid": pl.col("n_truth") + 1}),
    (_PIXELS, {"n_all": pl.col("n_valid") - 1}),
    (_TRUTH, {"n_valid": pl.lit(None, pl.Int64)}),
    (_TRUTH, {"truth": pl.lit("none")}),
    (_TRUTH, {"truth": pl.lit("none"), "n_valid": pl.lit(None, pl.Int64)}),
    *((_SAMPLE, {name: pl.col(name) + 1}) for name in ("height", "width", "n_truth")),
    *((_SAMPLE, {name: pl.lit("other")}) for name in ("group", "truth_digest")),
    (_CLEAN, {"clean_epe_sum": pl.col("clean_epe_sum") * (1 + 1e-12)}),
    (_CLEAN, {"clean_epe_sum_occ": pl.col("clean_epe_sum_occ") + 1}),
    (_NO_ATTACK, {"attack_linf": pl.lit(1.0)}),
]
"""A rule, and a change of one row that breaks it; `test_attack_rows` has those of attacks."""


def test_every_rule_has_a_planted_change():
    assert {rule for rule, _ in _CHANGES} == row_rules().keys() - {"attacks are within their budgets"}


@pytest.mark.parametrize(("rule", "change"), _CHANGES)
def test_each_rule_rejects_its_planted_change(rule, change, measured_rows):
    cell = ("2", "fog", 2)
    where = pl.all_horizontal(pl.col(name) == value for name, value in zip(ROW_KEY, cell, strict=True))
    changed = measured_rows.with_columns(
        pl.when(where).then(value).otherwise(name).alias(name) for name, value in change.items()
    )
    assert cell in dict(broken_rules(changed, row_rules()))[rule].select(ROW_KEY).rows()
    assert dict(broken_rules(measured_rows, row_rules()))[rule].is_empty()

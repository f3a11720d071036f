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


_GREATER = pl.col("epe_sum") + 2 * pl.col("rcre_sum") + 1
_ONLY_ATTACKS = {"attack values are measured together", "attacks are within their budgets"}
_ONLY_ATTACKS |= {"capped errors are at most the errors", "warnings of attacks are known"}  # see test_attack_rows
_CHANGES = [
    ("sums and their counts are measured together", {"epe_sum_occ": pl.lit(None, pl.Float64)}),
    ("no mean is beyond the range of its unit", {"photometric_sum": 255.0 * pl.col("n_photometric") + 1}),
    ("attack values are those of an attack", {"attack_linf": pl.lit(1.0)}),
    ("clean errors are those of the clean row", {"clean_epe_sum": pl.col("clean_epe_sum") * (1 + 1e-12)}),
    ("an error changes by at most the change of the flow", {"epe_sum": _GREATER}),
    (
        "a flow's length changes by at most the change of the flow",
        {"pred_magnitude_sum": pl.col("pred_magnitude_sum") + 3 * pl.col("rcre_all_sum") + 1},
    ),
    ("a frame has its pixels", {"n_invalid": pl.lit(1, pl.Int64)}),
    ("regions are those of pixels with ground truth", {"n_valid": pl.lit(None, pl.Int64)}),
    ("errors exist if the corruption leaves the ground truth", {"truth": pl.lit("none")}),
    ("regions add up to the whole", {"epe_sum_s40": pl.col("epe_sum_s40") * (1 + 1e-6)}),
    ("outliers of 5 px are outliers of 3 and 1 px", {"px5_count": pl.col("px3_count") + 1}),
    ("an error is at least that of its outliers", {"epe_sum": pl.col("epe_sum") * 0.01}),
    (
        "the length of the ground truth fits its regions",
        {"magnitude_sum": 10.0 * pl.col("n_s10_40") + 40.0 * pl.col("n_s40") - 1},
    ),
    (
        "a flow is as long as the ground truth, up to its error",
        {
            "pred_magnitude_sum": pl.lit(0.0),
            "epe_sum": 0.9 * pl.col("magnitude_sum"),
        },
    ),
    ("no confidence ranks errors better than the oracle", {"error_at_80": pl.lit(1.0), "oracle_at_80": pl.lit(1.1)}),
    (
        "a flow changes on all pixels at least as much as on those with ground truth",
        {"rcre_sum": pl.col("rcre_all_sum") + 1e-3},
    ),
    ("clean frames have neither severity nor change nor spread", {"spread_sum": pl.lit(1e-300)}),
    ("rows of a sample have one size and group", {"group": pl.lit("other")}),
    ("rows of a sample have one ground truth", {"magnitude_sum": pl.col("magnitude_sum") * (1 + 1e-12)}),
    ("no mean is beyond the range of its unit", {"wauc_sum": pl.col("n_valid") + 1.0}),
    ("no mean is beyond the range of its unit", {"rejected_count": pl.col("n_all") + 1}),
    ("no mean is beyond the range of its unit", {"fl_count_s0_10": pl.col("n_s0_10") + 1}),
    ("clean errors are those of the clean row", {"clean_epe_sum_occ": pl.col("clean_epe_sum_occ") + 1}),
    (
        "an error changes by at most the change of the flow",
        {"epe_sum_occ": pl.col("epe_sum_occ") + 2 * pl.col("rcre_sum_occ") + 1},
    ),
    ("clean frames have neither severity nor change nor spread", {"rcre_sum_occ": pl.lit(1.0)}),
]
"""A rule, and a change of one row that breaks it; some for columns of a region, which have the rules of the whole."""


def test_every_rule_has_a_planted_change():
    assert {rule for rule, _ in _CHANGES} == RULES.keys() - _ONLY_ATTACKS


@pytest.mark.parametrize(("rule", "change"), _CHANGES)
def test_each_rule_rejects_its_planted_change(rule, change, measured_rows):
    cell = ("2", "clean", 0) if rule.startswith("clean frames") else ("2", "fog", 2)
    where = pl.all_horizontal(pl.col(name) == value for name, value in zip(ROW_KEY, cell, strict=True))
    changed = measured_rows.with_columns(
        pl.when(where).then(value).otherwise(name).alias(name) for name, value in change.items()
    )
    assert cell in dict(broken_rules(changed))[rule].select(ROW_KEY).rows()
    assert dict(broken_rules(measured_rows))[rule].is_empty()

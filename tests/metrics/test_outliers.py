from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.errors import DataError
from robustflow.flowio import read_flow
from robustflow.metrics.epe import epe_map, magnitude_map
from robustflow.metrics.outliers import outlier_sums

from . import naive
from .strategies import cases


def _one(error, magnitude=0.0):
    return outlier_sums(np.array([[float(error)]]), np.array([[float(magnitude)]]), np.array([[True]]))


@given(cases(finite=False))
def test_equals_the_naive_loop(case):
    pred, _, sample = case
    sums = outlier_sums(epe_map(pred, sample.flow), magnitude_map(sample.flow), sample.valid)
    errors = {p: naive.distance(pred[p], sample.flow[p]) for p in naive.pixels(sample.valid) if sample.valid[p]}
    known = {p: error for p, error in errors.items() if error is not None}
    assert sums.n == len(known)
    assert sums.fl_count == sum(naive.is_fl(error, sample.flow[p]) for p, error in known.items())
    assert sums.px1_count == sum(error > 1 for error in known.values())
    assert sums.px3_count == sum(error > 3 for error in known.values())
    assert sums.px5_count == sum(error > 5 for error in known.values())
    assert sums.wauc_sum == pytest.approx(sum(map(naive.wauc, known.values())), rel=1e-12)


@pytest.mark.parametrize("step", range(1, 101))
def test_wauc_counts_a_threshold_itself_and_nothing_above(step):
    threshold = step / 20
    for error in (threshold, math.nextafter(threshold, 0), math.nextafter(threshold, 9)):
        assert _one(error).wauc_sum == pytest.approx(naive.wauc(error), abs=1e-12)
    assert _one(threshold).wauc_sum > _one(math.nextafter(threshold, 9)).wauc_sum


@given(st.floats(0, 8), st.floats(0, 8))
def test_wauc_never_rewards_a_larger_error(a, b):
    small, large = sorted((a, b))
    assert 1 >= _one(small).wauc_sum >= _one(large).wauc_sum >= 0


def test_wauc_of_perfect_and_of_hopeless_flow():
    assert _one(0).wauc_sum == 1
    assert _one(5.001).wauc_sum == _one(1e300).wauc_sum == 0


def test_fl_needs_both_thresholds():
    assert _one(3.0).fl_count == 0
    assert _one(3.1).fl_count == 1
    assert _one(3.1, 61).fl_count == 1
    assert _one(3.1, 63).fl_count == 0
    assert _one(5.0, 100).fl_count == 0


def test_maps_of_different_size_are_refused():
    with pytest.raises(DataError, match="differ in size"):
        outlier_sums(np.zeros((2, 2)), np.zeros((2, 3)), np.ones((2, 2), np.bool_))


def test_lucas_kanade_estimate_of_kitti_2012(shared):
    """Known figure of this published estimate against its noc map: Fl 78.560 %."""
    folder = shared("data/kitti2012_colour_noc_only")
    (estimate,) = (folder / "LKflow").glob("*.png")
    flow, _ = read_flow(estimate)
    truth, valid = read_flow(folder / "training" / "flow_noc" / estimate.name.removeprefix("LKflow_"))
    sums = outlier_sums(epe_map(flow, truth), magnitude_map(truth), valid)
    assert 100 * sums.fl_count / sums.n == pytest.approx(78.560, abs=5e-4)

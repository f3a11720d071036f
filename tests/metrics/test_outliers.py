import math

import pytest

from robustflow.metrics.error_maps import WAUC_UNIT, is_fl_outlier, wauc_points

from . import naive


def _wauc(error):
    return wauc_points(float(error)) / WAUC_UNIT


def test_wauc_counts_a_threshold_itself_and_nothing_above():
    for threshold in (step / 20 for step in range(1, 101)):
        for error in (threshold, math.nextafter(threshold, 0), math.nextafter(threshold, 9)):
            assert _wauc(error) == pytest.approx(naive.wauc(error), abs=1e-12)
        assert _wauc(threshold) > _wauc(math.nextafter(threshold, 9))


def test_wauc_is_1_for_perfect_and_0_for_useless_flow():
    assert _wauc(0) == 1
    assert _wauc(5.001) == _wauc(1e300) == 0


def test_fl_needs_both_thresholds():
    assert not is_fl_outlier(3.0, 0.0)
    assert is_fl_outlier(3.1, 0.0)
    assert is_fl_outlier(3.1, 61.0)
    assert not is_fl_outlier(3.1, 63.0)
    assert not is_fl_outlier(5.0, 100.0)

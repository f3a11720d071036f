import math

import numpy as np
import pytest

from robustflow.core.types import Sample
from robustflow.metrics.error_maps import WAUC_UNIT, is_fl_outlier, wauc_points
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import measure

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


def test_pixels_with_errors_above_one_three_and_five_pixels_are_counted():
    limits = np.float32([1, 3, 5])
    pred = np.zeros((1, 6, 2), np.float32)
    pred[0, :, 0] = [*limits, *np.nextafter(limits, np.float32(9))]
    frame = np.zeros((1, 6, 3), np.uint8)
    sample = Sample("a", (frame, frame), 0 * pred, np.ones((1, 6), bool))
    row = measure(pred, pred, sample, Regions.of(sample))
    assert [row[f"px{limit}_count"] for limit in (1, 3, 5)] == [5, 3, 1]

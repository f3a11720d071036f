"""A single pass produces the same bytes as a separate pass for each sum."""

import math

import numpy as np
import pytest
from hypothesis import given

from robustflow.errors import DataError
from robustflow.metrics.error_maps import epe_map, error_sum, magnitude_map
from robustflow.metrics.regions import Regions
from robustflow.metrics.row_sums import row_sums
from robustflow.sample import Sample

from .strategies import cases


@given(cases(finite=False))
def test_every_sum_has_the_bytes_of_a_pass_of_its_own(case):
    pred, clean, sample = case
    regions = Regions.of(sample)
    sums = row_sums(pred, clean, sample.flow, regions)
    moved, error, before = epe_map(pred, clean), epe_map(pred, sample.flow), epe_map(clean, sample.flow)
    usable = ~np.isnan(moved)
    counted = regions.valid & usable
    assert sums.whole["rcre_all_sum"] == error_sum(moved).total
    assert sums.whole["pred_magnitude_sum"] == error_sum(magnitude_map(pred), usable).total
    for column, errors in (("epe_sum", error), ("rcre_sum", moved), ("clean_epe_sum", before)):
        assert sums.whole[column] == error_sum(errors, counted).total
    assert sums.whole["magnitude_sum"] == error_sum(regions.magnitude, counted).total
    for label in range(18):
        inside = counted & (regions.labels == label)
        assert sums.label_counts[0, label] == np.count_nonzero(inside)
        for number, errors in enumerate((error, moved, before)):
            assert sums.label_totals[number, label] == error_sum(errors, inside).total


@given(cases())
def test_a_region_adds_up_its_labels_exactly(case):
    pred, clean, sample = case
    regions = Regions.of(sample)
    sums = row_sums(pred, clean, sample.flow, regions)
    for name in regions.names:
        labels = [label for label in range(18) if (regions.mask(name) & (regions.labels == label)).any()]
        assert sums.region(name)["epe_sum"] == math.fsum(sums.label_totals[0, labels])
        assert sums.region(name)["n"] == np.count_nonzero(regions.mask(name))


def test_strided_flows_have_the_same_sums():
    rng = np.random.default_rng(0)
    flow, truth = rng.normal(0, 9, (2, 7, 11, 2)).astype(np.float32)
    frame = np.zeros((7, 11, 3), np.uint8)
    sample = Sample("a", (frame, frame), truth, np.ones((7, 11), np.bool_))
    straight = row_sums(flow, truth, truth, Regions.of(sample))
    assert row_sums(np.asfortranarray(flow), truth, truth, Regions.of(sample)).whole == straight.whole


def test_flows_of_another_size_are_refused():
    small, large = np.zeros((4, 4, 2), np.float32), np.zeros((4, 5, 2), np.float32)
    with pytest.raises(DataError, match="5x4"):
        row_sums(small, large, None, None)

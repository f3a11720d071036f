"""A single pass produces the same bytes as a separate pass for each sum."""

import math

import numpy as np
from hypothesis import given

from robustflow.metrics.error_maps import epe_map, error_sum, magnitude_map
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import row_sums

from .strategies import cases


@given(cases(finite=False))
def test_every_sum_has_the_bytes_of_a_separate_pass_and_regions_add_up_their_labels(case):
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
    for name in regions.names:
        labels = [label for label in range(18) if (regions.mask(name) & (regions.labels == label)).any()]
        assert sums.region(name)["epe_sum"] == math.fsum(sums.label_totals[0, labels])
        assert sums.region(name)["n"] == np.count_nonzero(regions.mask(name) & usable)

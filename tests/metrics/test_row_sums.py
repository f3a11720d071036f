"""A single pass produces the same bytes as a separate pass for each sum."""

import math

import numpy as np
from hypothesis import given

from robustflow.metrics.error_maps import epe_map, error_sum, magnitude_map
from robustflow.metrics.regions import MEMBERS, Regions
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
    assert sums["rcre_all_sum"] == error_sum(moved)[1]
    assert sums["pred_magnitude_sum"] == error_sum(magnitude_map(pred), usable)[1]
    assert sums["magnitude_sum"] == error_sum(regions.magnitude, counted)[1]
    for column, errors in (("epe_sum", error), ("rcre_sum", moved), ("clean_epe_sum", before)):
        assert sums[column] == error_sum(errors, counted)[1]
        for name in regions.names:
            inside = [error_sum(errors, counted & (regions.labels == label)) for label in MEMBERS[name]]
            assert sums[f"{column}_{name}"] == math.fsum(total for _, total in inside)
            assert sums[f"n_{name}"] == sum(n for n, _ in inside)

import numpy as np
from hypothesis import given

from robustflow.core.types import Sample
from robustflow.metrics.regions import REGIONS, Regions

from . import naive
from .strategies import cases


@given(cases())
def test_every_mask_equals_the_naive_loop(case):
    sample = case[2]
    regions = Regions.of(sample)
    found = naive.edges(sample.flow, sample.valid)
    masks = {name: regions.mask(name) for name in regions.names}
    assert set(REGIONS) - set(masks) == (set() if sample.occluded is not None else {"noc", "occ"})
    for y, x in naive.pixels(sample.valid):
        inside = {name for name, mask in masks.items() if mask[y, x]}
        if sample.valid[y, x]:
            assert inside == naive.regions_of(y, x, sample.flow, sample.occluded, found)
        else:
            assert not inside


def _sample(height=30, width=150, **fields):
    frame = np.zeros((height, width, 3), np.uint8)
    flow = np.zeros((height, width, 2), np.float32)
    defaults = {"flow": flow, "valid": np.ones((height, width), np.bool_)}
    return Sample("a", (frame, frame), **(defaults | fields))


def test_distance_bins_start_at_ten_and_sixty_pixels():
    flow = np.zeros((1, 150, 2), np.float32)
    flow[:, :3] = 9.0
    regions = Regions.of(_sample(1, flow=flow))
    edge = 3
    assert np.argwhere(regions.mask("d0_10")[0]).max() == edge + 9
    assert np.argwhere(regions.mask("d10_60")[0]).ravel().tolist() == list(range(edge + 10, edge + 60))
    assert np.argwhere(regions.mask("d60")[0]).min() == edge + 60


def test_magnitude_bins_start_at_ten_and_forty_pixels():
    flow = np.zeros((1, 4, 2), np.float32)
    flow[0, :, 0] = [np.nextafter(np.float32(10), np.float32(0)), 10, np.nextafter(np.float32(40), np.float32(0)), 40]
    regions = Regions.of(_sample(1, 4, flow=flow))
    assert regions.mask("s0_10").tolist() == [[True, False, False, False]]
    assert regions.mask("s10_40").tolist() == [[False, True, True, False]]
    assert regions.mask("s40").tolist() == [[False, False, False, True]]


def test_without_ground_truth_there_are_no_regions():
    assert Regions.of(_sample(flow=None, valid=None)) is None

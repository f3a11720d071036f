import numpy as np

from robustflow.core.types import Sample
from robustflow.metrics.regions import MEMBERS, Regions, edge_distance, motion_edges


def mask(regions, name):
    return np.isin(regions.labels, MEMBERS[name])


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
    assert np.argwhere(mask(regions, "d0_10")[0]).max() == edge + 9
    assert np.argwhere(mask(regions, "d10_60")[0]).ravel().tolist() == list(range(edge + 10, edge + 60))
    assert np.argwhere(mask(regions, "d60")[0]).min() == edge + 60


def test_magnitude_bins_start_at_ten_and_forty_pixels():
    flow = np.zeros((1, 4, 2), np.float32)
    flow[0, :, 0] = [np.nextafter(np.float32(10), np.float32(0)), 10, np.nextafter(np.float32(40), np.float32(0)), 40]
    regions = Regions.of(_sample(1, 4, flow=flow))
    assert mask(regions, "s0_10").tolist() == [[True, False, False, False]]
    assert mask(regions, "s10_40").tolist() == [[False, True, True, False]]
    assert mask(regions, "s40").tolist() == [[False, False, False, True]]


def test_without_ground_truth_there_are_no_regions():
    assert Regions.of(_sample(flow=None, valid=None)) is None


def test_distance_bins_of_a_plane_start_at_ten_and_sixty_pixels():
    flow = np.zeros((80, 80, 2), np.float32)
    flow[:3, :3] = 9.0
    regions, distance = (
        Regions.of(_sample(80, 80, flow=flow)),
        edge_distance(motion_edges(flow, np.ones((80, 80), bool))),
    )
    assert (distance[distance < 10].max(), distance[distance < 60].max()) > (9.8, 59.8)
    np.testing.assert_array_equal(mask(regions, "d0_10"), distance < 10)
    np.testing.assert_array_equal(mask(regions, "d60"), distance >= 60)

import numpy as np

from robustflow.core.types import Sample
from robustflow.metrics.regions import MEMBERS, Regions, edge_distance, motion_edges


def mask(regions, name):
    return np.isin(regions.labels, MEMBERS[name])


def regions_of(flow):
    frame = np.zeros((*flow.shape[:2], 3), np.uint8)
    return Regions.of(Sample("a", (frame, frame), flow, np.ones(flow.shape[:2], np.bool_)))


def test_magnitude_bins_start_at_ten_and_forty_pixels():
    flow = np.zeros((1, 4, 2), np.float32)
    flow[0, :, 0] = [np.nextafter(np.float32(10), np.float32(0)), 10, np.nextafter(np.float32(40), np.float32(0)), 40]
    regions = regions_of(flow)
    assert mask(regions, "s0_10").tolist() == [[True, False, False, False]]
    assert mask(regions, "s10_40").tolist() == [[False, True, True, False]]
    assert mask(regions, "s40").tolist() == [[False, False, False, True]]


def test_distance_bins_of_a_plane_start_at_ten_and_sixty_pixels():
    flow = np.zeros((80, 80, 2), np.float32)
    flow[:3, :3] = 9.0
    regions, distance = regions_of(flow), edge_distance(motion_edges(flow, np.ones((80, 80), bool)))
    assert (distance[distance < 10].max(), distance[distance < 60].max()) > (9.8, 59.8)
    np.testing.assert_array_equal(mask(regions, "d0_10"), distance < 10)
    np.testing.assert_array_equal(mask(regions, "d10_60"), (distance >= 10) & (distance < 60))
    np.testing.assert_array_equal(mask(regions, "d60"), distance >= 60)

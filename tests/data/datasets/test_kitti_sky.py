"""Test the rule that finds the sky in KITTI's frames, on made frames and on the shared pairs."""

import numpy as np
import pytest

from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.kitti import sky
from tests.shared_data import shared_folder

OPEN = [(slice(0, 60), slice(340, 370)), (slice(10, 60), slice(490, 540)), (slice(0, 90), slice(700, 750))]
"""Boxes of pair 000010 that show only sky."""
HIDDEN = [(slice(60, 100), slice(190, 280)), (slice(30, 90), slice(590, 640)), (slice(130, 375), slice(0, 1242))]
"""Boxes of pair 000010 that show trees, and everything below the highest measured pixel."""


def frame_with(bright, shape=(40, 60)):
    frame = np.full((*shape, 3), 90, np.uint8)
    frame[bright] = 250
    return frame


@pytest.mark.parametrize("name", ["000002", "000003", "000010"])
def test_no_measured_part_of_a_shared_kitti_pair_is_sky(name):
    sample = load_dataset("kitti2015", shared_folder("data", "kitti2015")).load(name)
    for frame in sample.frames:
        assert (sky(frame, sample.valid) & sample.valid).sum() == 0


def test_the_sky_of_a_shared_kitti_pair_is_found_between_its_trees():
    sample = load_dataset("kitti2015", shared_folder("data", "kitti2015")).load("000010")
    for frame in sample.frames:
        found = sky(frame, sample.valid)
        assert 0.08 < found.mean() < 0.12
        assert min(found[box].mean() for box in OPEN) > 0.99
        assert max(found[box].mean() for box in HIDDEN) < 0.001


def test_the_facades_of_shared_kitti_pairs_are_not_sky():
    data = load_dataset("kitti2015", shared_folder("data", "kitti2015"))
    street, square = data.load("000002"), data.load("000003")
    assert sky(square.frames[0], square.valid).mean() < 0.001
    assert sky(street.frames[0], street.valid)[:, 480:].mean() < 0.001


def test_a_bright_wall_that_the_scanner_reaches_is_not_sky():
    bright = np.zeros((40, 60), bool)
    bright[:30, 10:40] = True
    measured = np.zeros_like(bright)
    assert sky(frame_with(bright), measured).sum() == bright.sum()
    measured[20:30:2, 10:40:3] = True
    assert not sky(frame_with(bright), measured).any()


def test_a_bright_area_below_the_upper_edge_is_not_sky():
    bright = np.zeros((40, 60), bool)
    bright[1:30, 10:40] = True
    assert not sky(frame_with(bright), np.zeros_like(bright)).any()

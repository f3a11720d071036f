"""Test rolling shutter: the source frame of each row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import UsageError
from robustflow.corruptions import load_corruption
from robustflow.data.video.open_clip import rolling_frames, row_offsets
from robustflow.data.video.prepared import REACH

READOUTS = load_corruption("rolling_shutter").severities


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.lists(st.integers(0, 12), min_size=1, max_size=4))
def test_each_row_is_from_the_frame_nearest_to_its_time(seed, height, readouts):
    clip = np.random.default_rng(seed).integers(0, 256, (13, height, 4, 3), np.uint8)
    asked = []
    made = rolling_frames(lambda index: (asked.append(index), clip[index])[1], 6, readouts)
    reach = (max(readouts) + 1) // 2
    assert asked == list(range(6 - reach, 6 + reach + 1))  # each frame once, in ascending order
    for readout, frame in made.items():
        for y, row in enumerate(frame):
            time = readout * ((y + 0.5) / height - 0.5)
            nearest = [offset for offset in range(-7, 8) if abs(offset - time) < 0.5 + 1e-9]
            assert any((row == clip[6 + offset, y]).all() for offset in nearest)


def test_zero_readout_time_and_static_scenes_leave_frames_unchanged():
    clip = np.random.default_rng(0).integers(0, 256, (31, 20, 30, 3), np.uint8)
    np.testing.assert_array_equal(rolling_frames(clip.__getitem__, 15, [0])[0], clip[15])
    for frame in rolling_frames(lambda index: clip[7], 15, READOUTS).values():
        np.testing.assert_array_equal(frame, clip[7])


@pytest.mark.parametrize("height", [1, 16, 375, 2160])
def test_the_longest_readout_stays_within_the_frames_around_a_key_frame(height):
    offsets = row_offsets(height, READOUTS[-1])
    assert np.abs(offsets).max() <= REACH
    assert (np.diff(offsets) >= 0).all()


def test_rolling_shutter_without_master_frames_is_refused():
    with pytest.raises(UsageError):
        rolling_frames(lambda index: np.zeros((1, 1, 3), np.uint8), 0, [])

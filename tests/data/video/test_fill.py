"""Compare the filling of lost frames with a simple definition of the result, for any loss and any order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.data.video.variants import REORDER, Fill, fill_lost, pictures_in_order

from . import clips


def picture(index: int) -> np.ndarray:
    return np.full((3, 2), index % 251, np.uint8)


@given(st.data())
def test_every_frame_shows_the_last_decoded_one_before_it(data):
    count = data.draw(st.integers(1, 60))
    decoded = sorted(data.draw(st.sets(st.integers(0, count - 1), min_size=1)))
    fill = Fill(count)
    shown = list(fill_lost([(index, picture(index)) for index in decoded], fill))
    assert [index for index, _ in shown] == list(range(count))
    for index, what in shown:
        before = [k for k in decoded if k <= index]
        source = before[-1] if before else decoded[0]
        assert what[0, 0] == source % 251
        assert clips.shown_as(fill, index) == source
    assert fill.frames_lost == count - len(decoded)


@given(st.permutations(range(20)), st.lists(st.integers(-5, 40), max_size=10))
def test_order_of_arrival_does_not_matter(order, strangers):
    """Test twenty frames in any order, with duplicates and indices outside the clip."""
    arrivals = [(index, picture(index)) for index in order]
    arrivals += [(index, picture(index)) for index in strangers]
    fill = Fill(20)
    assert [index for index, _ in pictures_in_order(arrivals, fill)] == list(range(20))
    assert fill.dropped == len(strangers)


def test_buffer_of_waiting_frames_is_bounded():
    """A frame that arrives too late for the buffer is dropped."""
    late = REORDER + 5
    arrivals = [(index, picture(index)) for index in range(1, 1 + late)] + [(0, picture(0))]
    fill = Fill(late + 1)
    shown = [(index, int(what[0, 0])) for index, what in fill_lost(arrivals, fill)]
    assert shown[0] == (0, 1)
    assert fill.dropped == 1


def test_clip_without_a_decoded_frame_is_refused():
    with pytest.raises(DataError, match="none of the 5 frames"):
        list(fill_lost([], Fill(5)))

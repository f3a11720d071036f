"""Test which frames multi-frame models receive at every position in a sequence."""

from types import SimpleNamespace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from robustflow.core.errors import ModelError
from robustflow.models import Window
from robustflow.models.base import place_of_pair, window_of

from ..refusals import refusal

there = st.builds(lambda before, after: range(-before, 2 + after), st.integers(0, 9), st.integers(0, 9))
windows = st.builds(Window, st.integers(0, 5), st.integers(0, 5), st.sampled_from(["repeat", "short", "inside"]))


@given(window=windows, there=there)
def test_window_contains_the_pair_and_only_existing_frames(window, there):
    offsets = window.offsets(there)
    first = place_of_pair(offsets)
    assert offsets[first : first + 2] == (0, 1)
    assert set(offsets) <= set(there)
    assert list(offsets) == sorted(offsets)
    assert list(dict.fromkeys(offsets)) == list(range(offsets[0], offsets[-1] + 1)), "no frame may be skipped"


@given(window=windows, there=there)
def test_window_has_as_many_frames_as_its_ends_allow(window, there):
    offsets, whole = window.offsets(there), window.before + 2 + window.after
    if window.ends == "repeat":
        assert len(offsets) == whole
        assert place_of_pair(offsets) == window.before
    elif window.ends == "inside":
        assert len(offsets) == min(whole, len(there))
    else:
        assert place_of_pair(offsets) == min(window.before, -there.start)
        assert len(offsets) - place_of_pair(offsets) == 2 + min(window.after, there.stop - 2)


@given(window=windows, there=there)
def test_far_from_the_ends_all_are_the_same(window, there):
    assume(-there.start >= window.before and there.stop - 2 >= window.after)
    assert window.offsets(there) == tuple(range(-window.before, window.after + 2))


@given(window=windows, there=there)
def test_frames_farther_than_the_reach_make_no_difference(window, there):
    near = range(max(there.start, -window.reach), min(there.stop, 2 + window.reach))
    assert window.offsets(near) == window.offsets(there)


def test_window_is_read_from_a_tuple_or_list():
    assert window_of(SimpleNamespace(window=(3, 1))) == Window(3, 1, "repeat")
    assert window_of(SimpleNamespace(window=[0, 2, "short"])) == Window(0, 2, "short")


@pytest.mark.parametrize("declared", [None, 2, (2,), (0, 0), (-1, 1), (1.0, 1), (True, 1), (1, 1, "wrap"), "21"])
def test_invalid_window_is_refused(declared):
    refusal(lambda: window_of(SimpleNamespace(window=declared)), ModelError, "window")

"""The colour wheel of Baker et al. has its published properties and matches a loop written from their description."""

from __future__ import annotations

import colorsys
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.media.colours import colour_wheel, flow_colours, flow_radius
from tests.refusals import refusal

STRETCHES = (15, 6, 4, 11, 13, 6)


def _naive_wheel() -> list[list[int]]:
    """Build the colour wheel like the paper's software: six loops, each of which changes one channel."""
    ry, yg, gc, cb, bm, mr = STRETCHES
    wheel = [[255, 255 * i // ry, 0] for i in range(ry)]
    wheel += [[255 - 255 * i // yg, 255, 0] for i in range(yg)]
    wheel += [[0, 255, 255 * i // gc] for i in range(gc)]
    wheel += [[0, 255 - 255 * i // cb, 255] for i in range(cb)]
    wheel += [[255 * i // bm, 0, 255] for i in range(bm)]
    wheel += [[255, 0, 255 - 255 * i // mr] for i in range(mr)]
    return wheel


def _naive_colour(u: float, v: float, radius: float) -> list[int]:
    wheel = _naive_wheel()
    length = math.hypot(u, v) / radius
    place = (math.atan2(-v, -u) / math.pi + 1) / 2 * (len(wheel) - 1)
    first = int(place)
    second = (first + 1) % len(wheel)
    out = []
    for channel in range(3):
        colour = (1 - (place - first)) * wheel[first][channel] / 255 + (place - first) * wheel[second][channel] / 255
        colour = 1 - length * (1 - colour) if length <= 1 else colour * 0.75
        out.append(int(255 * colour))
    return out


def test_the_wheel_has_the_published_stretches():
    np.testing.assert_array_equal(colour_wheel(), _naive_wheel())
    assert len(colour_wheel()) == 55
    hues = [colorsys.rgb_to_hsv(*(colour / 255))[0] for colour in colour_wheel()]
    assert hues == sorted(hues), "the hue must go round the wheel exactly once"


@given(st.floats(-200, 200, width=32), st.floats(-200, 200, width=32), st.floats(0.5, 100))
def test_every_vector_has_the_papers_colour(u, v, radius):
    got = flow_colours(np.array([[[u, v]]], np.float32), radius)[0, 0].astype(int)
    expected = np.array(_naive_colour(u + 0.0, v + 0.0, radius))
    length = math.hypot(u, v) / radius
    if abs(length - 1) > 1e-9:  # the colour jumps at full saturation, so a rounding error could change it
        assert np.abs(got - expected).max() <= 1


def test_unknown_vectors_are_black_and_zero_vectors_white():
    flow = np.zeros((2, 2, 2), np.float32)
    flow[0, 0] = np.nan
    flow[0, 1] = np.inf
    colours = flow_colours(flow, 1.0, np.array([[True, True], [True, False]]))
    assert colours.tolist() == [[[0] * 3, [0] * 3], [[255] * 3, [0] * 3]]


def test_radius_ignores_outliers_and_what_is_unknown():
    flow = np.full((20, 20, 2), (3, 4), np.float32)
    flow[0, 0] = 1e6
    flow[0, 1] = np.nan
    assert flow_radius(flow) == 5.0
    valid = np.zeros((20, 20), bool)
    assert flow_radius(flow, valid) == 1.0
    assert flow_radius(0 * flow[1:]) == 1.0


@pytest.mark.parametrize(("shape", "radius"), [((2, 2), 1.0), ((2, 2, 3), 1.0), ((2, 2, 2), 0.0), ((2, 2, 2), np.nan)])
def test_colours_of_an_invalid_flow_are_refused(shape, radius):
    refusal(lambda: flow_colours(np.zeros(shape, np.float32), radius), DataError, "flow")

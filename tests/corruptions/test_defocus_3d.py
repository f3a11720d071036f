"""Test near and far focus: the thin-lens model, and pixels on both sides of an edge."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.rng import Rng
from robustflow.corruptions.depth.defocus_3d import FarFocus, NearFocus, ThinLens
from robustflow.corruptions.kernels.disk import convolve_disk

from .pictures import picture, seen

both = pytest.mark.parametrize("kind", [NearFocus, FarFocus])
NEAR, FAR = 2.0, 12.0


def halves(shape):
    """Return the depth of a scene with a near part at `NEAR` and a far part at `FAR`."""
    depth = np.full(shape, NEAR, np.float32)
    depth[:, shape[1] // 2 :] = FAR
    return depth


def drawn(kind, severity, first, second=None):
    return kind().draw_scene(Rng.of("nothing"), severity, seen(first, second))


def differs_by_rounding(out, expected):
    difference = np.abs(out.astype(int) - expected.astype(int))
    return difference.max() <= 1 and (difference > 0).mean() < 1e-3


@both
@settings(max_examples=15)
@given(severity=st.integers(1, 5), size=st.tuples(st.integers(20, 70), st.integers(20, 150)), seed=st.integers(0, 99))
def test_a_plane_at_the_stated_depth_is_the_flat_disk_of_the_severity(kind, severity, size, seed):
    frame, radius = picture(*size, seed=seed), kind.paper_severities[severity - 1]
    out_of_focus = np.full(size, FAR if kind is NearFocus else NEAR, np.float32)
    state = drawn(kind, severity, halves(size), out_of_focus)
    assert differs_by_rounding(kind().apply(frame, state, 1), convolve_disk(frame, radius, 0.0))


@given(distance=st.floats(0.6, 500), focus=st.floats(1, 50), stop=st.floats(1.4, 8))
def test_the_radius_is_that_of_a_thin_lens(distance, focus, stop):
    length, pitch = 0.008, 4.65e-6  # metres
    disk = length**2 / stop * abs(distance - focus) / (distance * (focus - length)) / pitch
    frame, depth = picture(30, 40), np.full((30, 40), distance, np.float32)
    state = drawn(NearFocus, 1, depth)._replace(
        lens=ThinLens(focus, length**2 / stop / (focus - length) / pitch / 2, 25.0)
    )
    expected = min(disk / 2, 25.0)
    # a disk includes the pixels whose centres it covers; if one is very close to the edge, either result is correct
    sides = [convolve_disk(frame, expected * factor, 0.0) for factor in (1 - 1e-5, 1 + 1e-5)]
    assert any(differs_by_rounding(NearFocus().apply(frame, state, 0), side) for side in sides)


def before_a_wall():
    """Return a block at `NEAR` in front of a wall at `FAR`, as (depth, mask)."""
    mask = np.zeros((60, 80), bool)
    mask[20:40, 25:55] = True
    return np.where(mask, NEAR, FAR).astype(np.float32), mask


def test_a_sharp_foreground_does_not_bleed_into_the_blurred_background():
    depth, block = before_a_wall()
    frame = picture(60, 80)
    frame[..., 0] = np.where(block, 255, 0)
    out = NearFocus().apply(frame, drawn(NearFocus, 4, depth), 0)
    assert (out[~block, 0] == 0).all()
    assert np.array_equal(out[block], frame[block])
    assert (out[~block] != frame[~block]).any(axis=1).mean() > 0.9


@pytest.mark.parametrize("severity", [1, 3, 5])
def test_a_blurred_foreground_spreads_over_the_sharp_background_in_proportion(severity):
    depth, block = before_a_wall()
    frame = np.where(block, 255, 30).astype(np.uint8)[..., None].repeat(3, axis=2)
    expected = convolve_disk(frame, FarFocus.paper_severities[severity - 1], 0.0)
    assert (expected[~block] > 30).any()
    assert (expected[block] < 255).any()
    out = FarFocus().apply(frame, drawn(FarFocus, severity, depth), 0)
    assert np.abs(out.astype(int) - expected.astype(int)).max() <= 1


def test_a_blurred_foreground_leaves_the_background_sharp():
    depth, block = before_a_wall()
    frame = picture(60, 80)
    out = FarFocus().apply(frame, drawn(FarFocus, 1, depth), 0)
    untouched = np.ones_like(block)
    untouched[20 - 3 : 40 + 3, 25 - 3 : 55 + 3] = False
    assert np.array_equal(out[untouched], frame[untouched])


@both
def test_a_scene_at_one_depth_is_in_focus(kind):
    frame = picture(40, 50)
    assert np.array_equal(kind().apply(frame, drawn(kind, 5, np.full((40, 50), 4.0, np.float32)), 0), frame)

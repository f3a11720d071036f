"""Compare first-order properties with rays close to the axis and with textbook values."""

from __future__ import annotations

import pytest

from robustflow.corruptions.optics.lens import first_order_of, trace

from .lenses import bundle, cooke_triplet, lens_of

TINY = 1e-5


def test_focal_length_and_back_focus_are_where_rays_near_the_axis_meet_it():
    lens = cooke_triplet()
    order = first_order_of(lens)
    _, end = trace(lens, bundle(TINY), 0.55)
    slope = end.m[0] / end.n[0]
    assert order.focal_length == pytest.approx(-TINY / slope, rel=1e-9)
    assert order.back_focus == pytest.approx(lens.surfaces[-1].thickness - end.y[0] / slope, rel=1e-9)


def test_entrance_pupil_is_the_image_of_the_stop():
    lens = cooke_triplet()
    order = first_order_of(lens)
    chief, _ = trace(lens, bundle(-TINY * order.pupil_position, TINY), 0.55)
    assert abs(chief[lens.stop, 1, 0]) < 1e-12
    edge, _ = trace(lens, bundle(TINY * order.pupil_magnification), 0.55)
    assert edge[lens.stop, 1, 0] == pytest.approx(TINY, rel=1e-9)


def test_a_stop_in_front_is_its_own_entrance_pupil():
    lens = lens_of([(0.0, 3.0, "air", 2.0), (30.0, 2.0, "N-BK7", 6.0), (-30.0, 28.0, "air", 6.0)], stop=0)
    order = first_order_of(lens)
    assert (order.pupil_position, order.pupil_magnification) == (0.0, 1.0)


def test_focal_length_of_a_thin_lens_follows_the_lensmaker_equation():
    r1, r2, d = 40.0, -60.0, 5.0
    lens = lens_of([(0.0, 0.0, "air", 2.0), (r1, d, "N-SF6", 9.0), (r2, 30.0, "air", 9.0)], stop=0)
    n = 1.8051808
    power = (n - 1) * (1 / r1 - 1 / r2 + (n - 1) * d / (n * r1 * r2))
    assert first_order_of(lens, 0.5875618).focal_length == pytest.approx(1 / power, rel=1e-5)

"""Compare glasses, first-order properties and the ray tracer with catalogues, textbooks and closed-form solutions."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.corruptions.optics.lens import (
    abbe_number,
    first_order_of,
    read_lens,
    refractive_index,
    trace,
)

from ...refusals import refusal
from .lenses import bundle, cooke_triplet, lens_of, plano_hyperbolic, thin_lens

# n_d and V_d as printed in the Schott data sheets.
CATALOGUE = {
    "N-FK51A": (1.48656, 84.47),
    "N-BK7": (1.51680, 64.17),
    "N-BAK4": (1.56883, 55.98),
    "N-SK16": (1.62041, 60.32),
    "N-F2": (1.62005, 36.43),
    "N-SF5": (1.67271, 32.25),
    "N-SF11": (1.78472, 25.68),
    "N-SF6": (1.80518, 25.36),
    "N-SF66": (1.92286, 20.88),
    "N-LASF9": (1.85025, 32.17),
}


@pytest.mark.parametrize("name", CATALOGUE)
def test_index_and_dispersion_are_those_of_the_data_sheet(name):
    n_d, v_d = CATALOGUE[name]
    assert refractive_index(name, 0.5875618) == pytest.approx(n_d, abs=6e-6)
    assert abbe_number(name) == pytest.approx(v_d, abs=6e-3)


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


def test_focal_length_of_a_thin_lens_follows_the_lensmaker_equation():
    r1, r2, d = 40.0, -60.0, 5.0
    lens = lens_of([(0.0, 0.0, "air", 2.0), (r1, d, "N-SF6", 9.0), (r2, 30.0, "air", 9.0)], stop=0)
    n = 1.8051808
    power = (n - 1) * (1 / r1 - 1 / r2 + (n - 1) * d / (n * r1 * r2))
    assert first_order_of(lens, 0.5875618).focal_length == pytest.approx(1 / power, rel=1e-5)


WAVELENGTH = 0.5875618


def test_one_sphere_refracts_as_snell_says():
    """Trace a meridional ray through a sphere using angles: sin(i) = h / R, Snell's law, and a straight line."""
    n, radius, depth, height = refractive_index("N-BK7", WAVELENGTH), 30.0, 40.0, 7.0
    lens = lens_of([(0.0, 0.0, "air", 9.0), (radius, depth, "N-BK7", 20.0), (0.0, 10.0, "air", 20.0)], stop=0)
    path, _ = trace(lens, bundle(height), WAVELENGTH)
    incidence = math.asin(height / radius)
    deviation = incidence - math.asin(math.sin(incidence) / n)
    sag = radius - math.sqrt(radius**2 - height**2)
    assert path[1, 1, 0] == pytest.approx(height, abs=1e-13)
    assert path[1, 2, 0] == pytest.approx(sag, abs=1e-13)
    assert path[2, 1, 0] == pytest.approx(height - (depth - sag) * math.tan(deviation), abs=1e-12)


def test_a_plano_hyperbolic_lens_has_no_spherical_aberration():
    _, end = trace(plano_hyperbolic(WAVELENGTH), bundle(np.linspace(0.0, 14.0, 15)), WAVELENGTH)
    assert end.alive.all()
    assert np.abs(end.y).max() < 1e-12


@pytest.mark.parametrize("shape", [-2.0, -1.0, 0.0, 0.7, 1.0, 2.0])
def test_spherical_aberration_of_a_thin_lens_equals_third_order_theory(shape):
    """Third-order aberration, object at infinity (Jenkins & White, "Fundamentals of Optics", eq. 9m):

    1/s_h - 1/s_p = h^2 / (8 f^3) / (n (n - 1)) [(n+2)/(n-1) q^2 - 4(n+1) q + (3n+2)(n-1) + n^3/(n-1)]
    """
    focal_length, height, n = 100.0, 0.5, refractive_index("N-BK7", WAVELENGTH)
    lens = thin_lens(shape, focal_length, WAVELENGTH)
    path, end = trace(lens, bundle(height), WAVELENGTH)
    crossing = focal_length + end.y[0] / -(end.m[0] / end.n[0])
    third_order = (
        height**2 / (8 * focal_length**3) / (n * (n - 1))
        * ((n + 2) / (n - 1) * shape**2 - 4 * (n + 1) * shape + (3 * n + 2) * (n - 1) + n**3 / (n - 1))
    )  # fmt: skip
    assert 1.0 / crossing - 1.0 / focal_length == pytest.approx(third_order, rel=2e-3)
    assert path[0, 1, 0] == height


@settings(max_examples=40)
@given(height=st.floats(-4.0, 4.0), across=st.floats(-4.0, 4.0), tangent=st.floats(-0.2, 0.2))
def test_directions_stay_unit_vectors_and_meet_the_surfaces(height, across, tangent):
    lens = cooke_triplet()
    path, end = trace(lens, bundle(height, tangent, across), 0.48)
    if end.alive[0]:
        assert end.l**2 + end.m**2 + end.n**2 == pytest.approx(1.0, abs=1e-14)
        for k, surface in enumerate(lens.surfaces):
            x, y, z = path[k, :, 0]
            c = surface.curvature
            assert c * (x * x + y * y + z * z) == pytest.approx(2.0 * z, abs=1e-11)


def test_rays_that_miss_or_are_totally_reflected_are_dead_and_stay_finite():
    ball = lens_of([(0.0, 1.0, "air", 9.0), (5.0, 9.0, "N-SF66", 5.0), (-5.0, 20.0, "air", 5.0)], stop=0)
    _, end = trace(ball, bundle([0.5, 6.0]), 0.55)
    assert end.alive.tolist() == [1.0, 0.0]
    plane = lens_of([(0.0, 1.0, "air", 9.0), (6.0, 3.0, "N-SF66", 6.0), (0.0, 20.0, "air", 9.0)], stop=0)
    _, end = trace(plane, bundle([0.5, 5.5]), 0.55)
    assert end.alive.tolist() == [1.0, 0.0]
    assert all(np.isfinite(part).all() for part in end)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["surfaces"][0].update(glass="UNOBTAINIUM"),
        lambda c: c["surfaces"][0].update(thickness=-1),
        lambda c: c["surfaces"][0].update(semi_diameter=0),
        lambda c: c["surfaces"][0].update(note="x"),
        lambda c: c.update(stop=0),
        lambda c: c.update(stop=12),
        lambda c: c["surfaces"][-1].update(glass="N-BK7"),
        lambda c: c.update(half_field=120),
        lambda c: c.pop("f_number"),
    ],
)
def test_faulty_prescription_is_refused(tmp_path, change):
    path, content = tmp_path / "lens.json", json.loads(cooke_triplet().model_dump_json())
    change(content)
    path.write_text(json.dumps(content))
    refusal(lambda: read_lens(path), DataError, path)


@pytest.mark.parametrize("content", ["", "[]", "{", '{"name": NaN}', "\x00\x01", None])
def test_file_that_is_missing_or_not_a_prescription_is_refused(tmp_path, content):
    path = tmp_path / "lens.json"
    if content is not None:
        path.write_text(content)
    refusal(lambda: read_lens(path), DataError, path)

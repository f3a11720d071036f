"""Compare our ray tracer with optiland's for the shipped lenses and three textbook lenses (extra `optics-test`)."""

import numpy as np
import pytest

from robustflow.corruptions.optics.design import shipped_lens
from robustflow.corruptions.optics.lens import (
    AIR,
    DESIGN_WAVELENGTH,
    SELLMEIER,
    Lens,
    first_order_of,
    launched,
    refractive_index,
    trace,
)
from robustflow.corruptions.optics.merit import aimed

from .lenses import cooke_triplet, plano_hyperbolic, thin_lens

pytestmark = pytest.mark.slow

LENSES = {
    **{f"severity {k}": lambda k=k: shipped_lens(k) for k in (1, 2, 3, 4, 5)},
    "Cooke triplet": cooke_triplet,
    "plano-hyperbolic": lambda: plano_hyperbolic(0.55),
    "thin lens": lambda: thin_lens(0.7, 100.0, 0.55),
}


def optiland_of(lens: Lens):
    """Return the same lens in optiland, with glasses from optiland's catalogue."""
    pytest.importorskip("optiland", reason="requires the extra optics-test: pip install 'robustflow[optics-test]'")
    from optiland.materials import Material
    from optiland.optic import Optic

    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    for k, surface in enumerate(lens.surfaces):
        optic.surfaces.add(
            index=k + 1,
            radius=1.0 / surface.curvature if surface.curvature else np.inf,
            conic=surface.conic,
            thickness=surface.thickness,
            material="air" if surface.glass == AIR else Material(surface.glass, reference="schott"),
            is_stop=k == lens.stop,
        )
    optic.surfaces.add(index=len(lens.surfaces) + 1)
    optic.set_aperture(aperture_type="imageFNO", value=lens.f_number)
    optic.fields.set_type("angle")
    optic.fields.add(y=lens.half_field)
    optic.wavelengths.add(value=DESIGN_WAVELENGTH, is_primary=True)
    return optic


@pytest.mark.parametrize("name", LENSES)
def test_rays_meet_every_surface_where_optiland_says(name):
    lens = LENSES[name]()
    optic = optiland_of(lens)
    from optiland.rays import RealRays

    rng = np.random.default_rng(3)
    fields = np.array([0.0, 0.6, 1.0]) * lens.field_tangent
    x_aimed, y_aimed, _ = aimed(lens, fields)
    for wavelength in (0.46, 0.54, 0.64):
        for f, tangent in enumerate(fields):
            # rays that fill the stop, bounded by the rays aimed at its bottom, top and side
            across, along = rng.uniform(-0.7, 0.7, (2, 40))
            x = x_aimed[9 + f] * across
            y = y_aimed[f] + np.where(along > 0, y_aimed[3 + f] - y_aimed[f], y_aimed[f] - y_aimed[6 + f]) * along
            rays, one = launched(x, y, np.full(40, tangent)), np.ones(40)
            path, end = trace(lens, rays, wavelength)
            other = RealRays(*rays[:6], one, one * wavelength)
            optic.surfaces.trace(other, skip=1)
            alive = end.alive > 0.0
            if name.startswith("severity"):
                alive &= (np.hypot(path[:, 0], path[:, 1]) <= lens.column("semi_diameter")[:, None]).all(axis=0)
            assert alive.sum() >= 36
            assert np.abs(np.asarray(optic.surfaces.x)[:-1, alive] - path[:, 0, alive]).max() < 1e-9
            assert np.abs(np.asarray(optic.surfaces.y)[:-1, alive] - path[:, 1, alive]).max() < 1e-9
            assert np.abs(np.asarray(other.x)[alive] - end.x[alive]).max() < 1e-9
            assert np.abs(np.asarray(other.y)[alive] - end.y[alive]).max() < 1e-9


@pytest.mark.parametrize("name", LENSES)
def test_focal_length_and_entrance_pupil_equal_optiland(name):
    lens = LENSES[name]()
    optic, order = optiland_of(lens), first_order_of(lens)
    assert order.focal_length == pytest.approx(float(np.ravel(optic.paraxial.f2())[0]), rel=1e-9)
    position = float(np.ravel(optic.paraxial.EPL())[0])
    assert order.pupil_position == pytest.approx(position, abs=1e-8)
    if name.startswith("severity"):
        diameter = float(np.ravel(optic.paraxial.EPD())[0])
        assert 2.0 * order.pupil_magnification * lens.stop_radius == pytest.approx(diameter, rel=1e-5)


def test_every_glass_has_optilands_index():
    pytest.importorskip("optiland", reason="requires the extra optics-test: pip install 'robustflow[optics-test]'")
    from optiland.materials import Material

    for glass in SELLMEIER:
        for wavelength in (0.42, 0.5461, 0.68):
            other = float(np.ravel(Material(glass, reference="schott").n(wavelength))[0])
            assert refractive_index(glass, wavelength) == pytest.approx(other, abs=1e-12)

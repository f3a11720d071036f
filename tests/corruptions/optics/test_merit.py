"""Compare the merit function's statistics with those of rendered PSFs, and residuals with their definitions."""

import numpy as np
import pytest

from robustflow.corruptions.optics.design import SAMPLES, Structure, goal_of, shipped_lens
from robustflow.corruptions.optics.merit import FIELDS, FREQUENCIES, Limits, blur_statistics
from robustflow.corruptions.optics.psf_field import shipped_field
from robustflow.corruptions.optics.render import field_rays, modulation, moments
from robustflow.corruptions.optics.residuals import fill_residuals, residual_count


@pytest.mark.parametrize("severity", [2, 4, 5])
def test_ray_statistics_are_those_of_the_rendered_psf(severity):
    """Statistics computed from rays agree with a Fourier sum over an image of the same rays."""
    lens, field = shipped_lens(severity), shipped_field(severity)
    tangential, sagittal = modulation(field, FREQUENCIES)
    radius = moments(field)
    for row in (0, 27, 63):
        rays = field_rays(lens, np.array([row / 63]), 48, 96)[0]
        sx, sy, weight = (np.stack([colour[part] for colour in rays]) for part in range(3))
        t, re, s, rms, mean = np.empty((3, 5)), np.empty((3, 5)), np.empty((3, 5)), np.empty(3), np.empty(3)
        blur_statistics(sx, sy, weight, t, re, s, rms, mean)
        # at the highest frequency, sampling at pixels causes aliasing, which does not affect the rays
        for frequency, tolerance in enumerate((0.02, 0.02, 0.02, 0.03, 0.06)):
            assert t[:, frequency] == pytest.approx(tangential[row, :, frequency], abs=tolerance)
            assert s[:, frequency] == pytest.approx(sagittal[row, :, frequency], abs=tolerance)
        assert rms == pytest.approx(radius.rms[row], abs=0.15)
        assert mean - mean[1] == pytest.approx(radius.y[row] - radius.y[row, 1], abs=0.1)
        assert (np.abs(re) <= t + 1e-12).all()


def singlet(bend: float):
    """Return the free parameters of a singlet, the arguments that follow them, and an array for the residuals."""
    structure, (_, goal) = Structure(("N-BK7",), 0), goal_of(2)
    index = structure.indices(SAMPLES)
    out = np.zeros(residual_count(index.shape[1] - 1))
    return np.array([bend, bend - 1.93, 0.1, 0.15, -0.5]), (index, structure.stop_surface, goal), out


def test_thin_glass_and_short_gaps_cost():
    """Violating any limit adds residuals; a manufacturable lens has none."""
    free, setting, out = singlet(1.2)

    def mechanical(limits):
        assert fill_residuals(free, *setting, limits, out)
        return (out[FIELDS.size * 51 + 2 :] ** 2).sum()

    free_of_limits = Limits(0.0, -50.0, 1e3, 0.0, -50.0, 1e3, 0.0)
    assert mechanical(free_of_limits) == 0.0
    for name, value in (("glass_centre", 50.0), ("glass_edge", 50.0), ("glass_most", 0.1), ("air_centre", 50.0),
                        ("air_edge", 50.0), ("length", 0.1), ("back", 500.0)):  # fmt: skip
        assert mechanical(free_of_limits._replace(**{name: value})) > 0.0


def test_a_lens_that_cannot_be_built_is_reported():
    free, setting, out = singlet(0.0)
    free[:2] = 0.0  # a plane-parallel plate has no focus
    assert not fill_residuals(free, *setting, Limits(), out)

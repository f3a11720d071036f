"""Test the PSFs of a lens: energy, symmetry, centring and resolution."""

import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.corruptions.optics.design import shipped_lens
from robustflow.corruptions.optics.lens import PIXEL, Rays, trace
from robustflow.corruptions.optics.psf_field import PsfField, half_digest, halved, manifest, shipped_field
from robustflow.corruptions.optics.render import field_rays, render_psfs

SEVERITIES = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_shipped_psfs_are_normalised_symmetric_and_centred(severity):
    field = shipped_field(severity)
    assert field.stack.shape == (64, 3, 61, 61)
    assert field.stack.dtype == np.float32
    assert field.stack.min() >= 0.0
    assert field.stack.astype(float).sum((2, 3)) == pytest.approx(1.0, abs=1e-6)
    assert (field.stack == field.stack[..., ::-1]).all()
    green = field.stack[:, 1].astype(float).sum(2)
    assert np.abs(green @ np.arange(-30, 31)).max() <= 0.05, "the ground truth remains valid"


@pytest.mark.parametrize("severity", SEVERITIES)
def test_psfs_on_the_axis_are_round(severity):
    """Rotational symmetry: at the image centre, rows and columns are equal except for the sampling of the pupil."""
    centre = shipped_field(severity).stack[0].astype(float)
    turned = np.abs(centre - centre.transpose(0, 2, 1)).sum((1, 2))
    assert turned.max() < 0.06


def test_every_ray_that_passes_the_stop_is_counted_once():
    """Energy: a window that contains the entire blur contains all rays, including the mirrored half."""
    lens = shipped_lens(2)
    for x, y, weight in field_rays(lens, np.array([0.3]), 30, 60)[0]:
        inside = (np.abs(x) < 30) & (np.abs(y - y[weight > 0].mean()) < 30)
        assert weight[inside].sum() == weight.sum()
        assert set(np.unique(weight)) <= {0.0, 1.0}
        # the fraction of the box that is transmitted by the round stop
        assert weight.mean() == pytest.approx(np.pi / 4 / 1.15**2, rel=0.03)


def test_rays_land_where_the_tracer_says():
    lens = shipped_lens(2)
    _, y, weight = field_rays(lens, np.array([0.5]), 4, 8, samples=1)[0][1]
    tangent = 0.5 * lens.field_tangent
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    one = np.ones(1)
    _, chief = trace(lens, Rays(0 * one, 0 * one, 0 * one, 0 * one, tangent * cosine * one, cosine * one, one), 0.54)
    assert weight.sum() > 0
    # the stop is in front of the lens, so the ray through its centre is the chief ray
    assert y[weight > 0].min() < chief.y[0] / PIXEL < y[weight > 0].max()


@pytest.mark.slow
@pytest.mark.parametrize("severity", SEVERITIES)
def test_every_lens_renders_to_the_shipped_bytes(severity):
    assert half_digest(halved(render_psfs(shipped_lens(severity)))) == manifest()[f"psf_s{severity}"]


@pytest.mark.parametrize(
    ("stack", "words"),
    [
        (np.zeros((64, 3, 61, 61)), "is zero"),
        (np.full((64, 3, 61, 61), np.nan), "non-finite"),
        (np.ones((63, 3, 61, 61)), "shape"),
        (np.ones((64, 3, 61)), "shape"),
    ],
)
def test_invalid_psf_stack_is_refused(stack, words):
    with pytest.raises(DataError, match=words):
        PsfField(stack)

"""Scales, gradients and upsampling match SciPy and plain formulas."""

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.ndimage import correlate1d, map_coordinates

from robustflow.models.dis.model import OPERATING_POINTS
from robustflow.models.dis.pyramid import (
    coefficients,
    enlarged,
    mirrored_once,
    pyramid,
    slopes,
    spline_weights,
    with_border,
)

from .naive import cubic

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("size", "full"), [((13, 22), (16, 24)), ((16, 16), (16, 16)), ((1, 9), (4, 12))])
def test_a_scale_is_the_one_before_filtered_and_taken_every_second_time(size, full):
    frame = RNG.integers(0, 256, (*size, 3)).astype(np.uint8)
    levels = pyramid(frame, *full, 2)
    wanted = np.pad(frame.astype(float), ((0, full[0] - size[0]), (0, full[1] - size[1]), (0, 0)), mode="edge")
    half = np.convolve([1, 5, 10, 10, 5, 1], [0.1, 0.8, 0.1]) / 32
    for level in levels:
        np.testing.assert_allclose(level.reshape(*wanted.shape), wanted, atol=1e-3)
        for axis in (0, 1):
            # for even lengths, SciPy's origin 0 puts the centre between pixels i - 1 and i, so odd indices are used
            wanted = correlate1d(wanted, half, axis=axis, mode="nearest")
            wanted = np.take(wanted, np.arange(1, wanted.shape[axis], 2), axis)


@pytest.mark.parametrize(("order", "degree"), [(2, 2), (4, 4)])
def test_slopes_of_polynomials_are_exact(order, degree):
    coefficients = RNG.normal(size=(degree + 1, degree + 1))
    y, x = np.mgrid[:9, :12] / 8
    image = polyval2d(y, x, coefficients)
    right, down = slopes(np.repeat(image, 3, axis=1).astype(np.float32), order)
    inside = np.s_[2:-2, 2:-2]
    for found, axis in ((down, 0), (right, 1)):
        exact = polyval2d(y, x, polyder(coefficients, axis=axis)) / 8
        for channel in range(3):
            np.testing.assert_allclose(found[:, channel::3][inside], exact[inside], atol=1e-5)


def test_borders_repeat_the_edge():
    image = RNG.normal(size=(5, 7, 3)).astype(np.float32)
    wanted = np.pad(image, ((4, 4), (4, 4), (0, 0)), mode="edge")
    np.testing.assert_array_equal(with_border(image.reshape(5, 21), 4).reshape(13, 15, 3), wanted)


@pytest.mark.parametrize("factor", [1, 2, 8])
def test_enlarged_flow_is_bilinear_between_centres_of_pixels(factor):
    flow = RNG.normal(size=(4, 6, 2)).astype(np.float32)
    out = enlarged(flow, factor, 4 * factor - 1, 6 * factor - 2 if factor > 2 else 6 * factor)
    y, x = np.mgrid[: out.shape[0], : out.shape[1]]
    at = np.stack([(y + 0.5) / factor - 0.5, (x + 0.5) / factor - 0.5])
    for i in range(2):
        wanted = factor * map_coordinates(flow[..., i].astype(float), at, order=1, mode="nearest")
        np.testing.assert_allclose(out[..., i], wanted, atol=1e-5 * factor)


@pytest.mark.parametrize("size", [(2, 3), (9, 14)])
def test_spline_equals_the_pixels_and_scipy_between_them(size):
    image = RNG.normal(size=(*size, 3))
    weighed = coefficients(image.astype(np.float32).reshape(size[0], -1)).reshape(*size, 3)
    height, width = size
    for y in np.linspace(0, height - 1, 3 * height):
        for x in np.linspace(0, width - 1, 3 * width):
            y0, x0 = min(int(y), height - 2), min(int(x), width - 2)
            rows = [mirrored_once(y0 + k, height) for k in range(-1, 3)]
            columns = [mirrored_once(x0 + k, width) for k in range(-1, 3)]
            near = weighed[np.ix_(rows, columns)]
            found = np.einsum("a,b,abc->c", spline_weights(y - y0), spline_weights(x - x0), near)
            np.testing.assert_allclose(found, cubic(image, [y], [x])[0], atol=1e-5)
            if y == int(y) and x == int(x):
                np.testing.assert_allclose(found, image[int(y), int(x)], atol=1e-5)


@pytest.mark.parametrize("height", [1, 7, 8, 16, 100, 375, 2160])
@pytest.mark.parametrize("width", [1, 12, 160, 1242, 3840])
@pytest.mark.parametrize("number", OPERATING_POINTS)
def test_scales_have_room_for_a_patch_and_reach_a_fifth_of_the_frame(number, height, width):
    point = OPERATING_POINTS[number]
    coarsest, finest = point.scales(height, width)
    assert 0 <= finest <= point.finest_scale
    assert finest <= coarsest
    longer, shorter = max(height, width), min(height, width)
    if coarsest:
        assert shorter / 2**coarsest >= point.patch_size
        assert coarsest <= np.log2(2 * longer / (5 * point.patch_size))
    if shorter / 2 ** (coarsest + 1) >= point.patch_size:
        assert coarsest + 1 > np.log2(2 * longer / (5 * point.patch_size))

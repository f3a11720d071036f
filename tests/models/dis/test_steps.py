"""The steps of dense inverse search match SciPy, plain sums of squares and plain loops."""

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.ndimage import correlate1d, gaussian_filter, map_coordinates
from scipy.sparse import lil_matrix
from scipy.sparse.linalg import spsolve

from robustflow.models.dis import refine
from robustflow.models.dis.dis_rgb import OPERATING_POINTS, densified
from robustflow.models.dis.pyramid import (
    coefficients,
    enlarged,
    mirrored_once,
    pyramid,
    slopes,
    spline_weights,
    with_border,
)
from robustflow.models.dis.refine import motion_tensors
from robustflow.models.dis.search import grid, inverse_search

from .naive import cubic, descended, flat, linear, mismatch

PATCH, STRIDE = 8, 5


def pair(seed=0, size=(30, 37), motion=(2, -1)):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(*size, 3)), (2, 2, 0), mode="wrap")
    image = (128 + 300 * noise).astype(np.float32)
    return image, np.roll(image, motion[::-1], axis=(0, 1))


def test_patches_end_where_plain_descent_ends():
    image1, image2 = pair()
    coarse = np.full((15, 19, 2), (0.6, -0.2), np.float32)
    found = inverse_search(flat(image1), flat(image2), coarse, PATCH, STRIDE, 12)
    rows, columns = grid(30, PATCH, STRIDE), grid(37, PATCH, STRIDE)
    assert found.shape == (rows.size, columns.size, 2)
    start, moved = np.array([1.2, -0.4]), 0
    for i, y in enumerate(rows):
        for j, x in enumerate(columns):
            wanted = descended(image1.astype(float), image2.astype(float), y, x, start, PATCH, 12)
            far = np.hypot(*(wanted - start)) > PATCH
            before, after = (
                mismatch(image1.astype(float), image2.astype(float), y, x, u, PATCH) for u in (start, wanted)
            )
            if far or after > before:
                wanted = start
            moved += wanted is not start
            np.testing.assert_allclose(found[i, j], wanted, atol=2e-3)
    assert moved > rows.size * columns.size / 2


def test_patch_displaced_by_more_than_its_size_keeps_its_initial_flow():
    image1, image2 = pair(1, (48, 64), (12, 0))
    found = inverse_search(flat(image1), flat(image2), np.zeros((1, 1, 2), np.float32), PATCH, STRIDE, 50)
    assert np.hypot(found[..., 0], found[..., 1]).max() <= PATCH


def test_textureless_patch_keeps_its_initial_flow():
    coarse = np.random.default_rng(0).normal(size=(12, 12, 2)).astype(np.float32)
    stripes = np.zeros((24, 24, 3), np.float32)
    stripes[:, ::4] = 200  # there is no texture along the stripes, so motion in this direction cannot be measured
    for image in (np.full((24, 24, 3), 9, np.float32), stripes):
        found = inverse_search(flat(image), flat(np.roll(image, 1, axis=1)), coarse, 8, 8, 12)
        # patches start at 0, 8, 16; the first centre is at 3.5, which is 1.5 in pixels of the coarse flow
        wanted = [[coarse[y : y + 2, x : x + 2].mean(axis=(0, 1)) * 2 for x in (1, 5, 9)] for y in (1, 5, 9)]
        np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_dense_flow_is_the_mean_weighed_by_difference_of_colour():
    image1, image2 = pair(2)
    rows, columns = grid(30, PATCH, STRIDE), grid(37, PATCH, STRIDE)
    found = np.random.default_rng(3).normal(0, 6, (rows.size, columns.size, 2)).astype(np.float32)
    total, weights = np.zeros((30, 37, 2)), np.zeros((30, 37, 1))
    for i, y in enumerate(rows):
        for j, x in enumerate(columns):
            # patches are sampled no further than just outside the frame
            top, left = np.clip(y + found[i, j, 1], -PATCH, 30), np.clip(x + found[i, j, 0], -PATCH, 37)
            looked = linear(image2.astype(float), top + np.arange(PATCH), left + np.arange(PATCH))
            window = np.s_[y : y + PATCH, x : x + PATCH]
            weight = 1 / np.maximum(1, np.linalg.norm(looked - image1[window], axis=2, keepdims=True))
            total[window] += weight * found[i, j]
            weights[window] += weight
    flow = densified(flat(image1), flat(image2), found, PATCH, STRIDE)
    np.testing.assert_allclose(flow, total / weights, atol=1e-3)


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


EPSILON = 1e-3


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(0)
    image1 = 128 + 300 * gaussian_filter(rng.normal(size=(18, 23, 3)), (1.5, 1.5, 0))
    image2 = np.roll(image1, 1, axis=1) + rng.normal(0, 2, image1.shape)
    flow = (gaussian_filter(rng.normal(size=(18, 23, 2)), (3, 3, 0)) * 4 + (0.7, 0)).astype(np.float32)
    return image1.astype(np.float32), image2.astype(np.float32), flow


def slope(image, axis):
    return correlate1d(image, np.array([1, -8, 0, 8, -1]) / 12, axis=axis, mode="nearest")


def energy_terms(case, du, dv):
    """E_I and E_G of every pixel, computed from their definitions, and the mask of pixels that stay in the frame."""
    image1, image2, flow = (part.astype(float) for part in case)
    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width] + flow[..., ::-1].transpose(2, 0, 1)
    inside = (y >= 0) & (y <= height - 1) & (x >= 0) & (x <= width - 1)
    y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
    warped = cubic(image2, y, x)
    middle, change = (image1 + warped) / 2, warped - image1
    colours, slopes_of_colours = 0.0, 0.0
    for c in range(3):
        quantities = [(middle[..., c], change[..., c])]
        quantities += [(slope(middle[..., c], axis), slope(change[..., c], axis)) for axis in (1, 0)]
        for n, (quantity, difference) in enumerate(quantities):
            qx, qy = slope(quantity, 1), slope(quantity, 0)
            term = (qx * du + qy * dv + difference) ** 2 / (qx**2 + qy**2 + 0.01)
            if n == 0:
                colours += term
            else:
                slopes_of_colours += term
    return colours, slopes_of_colours, inside


def test_energy_terms_equal_sums_of_squares(case):
    tensors = motion_tensors(flat(case[0]), flat(case[1]), case[2]).astype(float)
    for du, dv in ((0.0, 0.0), (0.5, -1.0), (-2.0, 0.25)):
        xx, xy, yy, xt, yt, tt = np.moveaxis(tensors, -1, 0)
        forms = xx * du * du + 2 * xy * du * dv + yy * dv * dv + 2 * xt * du + 2 * yt * dv + tt
        *wanted, inside = energy_terms(case, du, dv)
        assert 0 < (~inside).sum() < inside.size / 2
        np.testing.assert_array_equal(forms[~inside], 0)
        for i in range(2):
            np.testing.assert_allclose(forms[..., i][inside], wanted[i][inside], rtol=2e-4, atol=1e-3)


def test_relaxation_ends_at_the_solution_of_the_linear_system(case, monkeypatch):
    monkeypatch.setattr(refine, "SWEEPS", 3000)
    found = refine.refined(flat(case[0]), flat(case[1]), case[2], iterations=1)
    tensors = motion_tensors(flat(case[0]), flat(case[1]), case[2]).astype(float)
    flow = case[2].astype(float)
    height, width = flow.shape[:2]
    weight = np.array([refine.DELTA, refine.GAMMA]) / np.sqrt(tensors[..., 5] + EPSILON**2)
    padded = np.pad(flow, ((1, 1), (1, 1), (0, 0)), mode="edge")
    gradient = ((padded[1:-1, 2:] - padded[1:-1, :-2]) ** 2 + (padded[2:, 1:-1] - padded[:-2, 1:-1]) ** 2).sum(2) / 4
    smooth = refine.ALPHA / np.sqrt(gradient + EPSILON**2)
    n = height * width
    matrix, right = lil_matrix((2 * n, 2 * n)), np.zeros(2 * n)
    for y in range(height):
        for x in range(width):
            k = y * width + x
            xx, xy, yy, xt, yt, _ = (weight[y, x][:, None] * tensors[y, x]).sum(axis=0)
            matrix[k, k] += xx
            matrix[k, n + k] += xy
            matrix[n + k, k] += xy
            matrix[n + k, n + k] += yy
            right[k], right[n + k] = right[k] - xt, right[n + k] - yt
            for b, a in ((y, x + 1), (y + 1, x)):
                if b < height and a < width:
                    link, other = (smooth[y, x] + smooth[b, a]) / 2, b * width + a
                    for i in range(2):
                        pull = link * (flow[b, a, i] - flow[y, x, i])
                        for p, q, sign in ((k, other, 1), (other, k, -1)):
                            matrix[i * n + p, i * n + p] += link
                            matrix[i * n + p, i * n + q] -= link
                            right[i * n + p] += sign * pull
    change = spsolve(matrix.tocsr(), right).reshape(2, height, width).transpose(1, 2, 0)
    np.testing.assert_allclose(found, flow + change, atol=5e-3)


def test_the_energy_falls_with_every_iteration(case):
    tensors = motion_tensors(flat(case[0]), flat(case[1]), case[2]).astype(float)

    def energy(flow):
        du, dv = (flow - case[2]).astype(float).transpose(2, 0, 1)[..., None]
        xx, xy, yy, xt, yt, tt = np.moveaxis(tensors, -1, 0)
        forms = xx * du * du + 2 * xy * du * dv + yy * dv * dv + 2 * xt * du + 2 * yt * dv + tt
        padded = np.pad(flow.astype(float), ((1, 1), (1, 1), (0, 0)), mode="edge")
        across, along = padded[1:-1, 2:] - padded[1:-1, :-2], padded[2:, 1:-1] - padded[:-2, 1:-1]
        smooth = ((across**2 + along**2) / 4).sum(axis=2)
        data = np.sqrt(np.maximum(forms, 0) + EPSILON**2) @ np.array([refine.DELTA, refine.GAMMA])
        return float((data + refine.ALPHA * np.sqrt(smooth + EPSILON**2)).sum())

    energies = [energy(refine.refined(flat(case[0]), flat(case[1]), case[2], iterations=n)) for n in range(5)]
    assert energies == sorted(energies, reverse=True)
    assert energies[-1] < 0.8 * energies[0]

"""The refinement's terms match plain sums of squares, it agrees with a direct solver, and the energy decreases."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter
from scipy.sparse import lil_matrix
from scipy.sparse.linalg import spsolve

from robustflow.models.dis import refine
from robustflow.models.dis.refine import motion_tensors

from .naive import cubic, flat

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

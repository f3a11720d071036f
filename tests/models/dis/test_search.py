"""The search and the dense flow match plain loops."""

import numpy as np
from scipy.ndimage import gaussian_filter

from robustflow.models.dis.model import densified
from robustflow.models.dis.search import grid, inverse_search

from .naive import descended, flat, linear, mismatch

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

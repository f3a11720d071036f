"""The steps of dense inverse search as plain float64 loops over patches, without the optimisations."""

import numpy as np
from scipy.ndimage import map_coordinates


def flat(image):
    """Convert an (H, W, C) image to the (H, W * C) float32 layout of the compiled functions."""
    return np.ascontiguousarray(image.reshape(image.shape[0], -1), np.float32)


def cubic(image, y, x):
    """Sample an (H, W, C) image at given positions with SciPy's cubic spline through the pixels, mirrored at the
    borders.
    """
    return np.stack([map_coordinates(image[..., c], [y, x], order=3, mode="mirror") for c in range(3)], -1)


def linear(image, y, x):
    at = np.broadcast_arrays(*np.ix_(y, x))
    return np.stack([map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(image.shape[2])], -1)


def central(image):
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2


def centred(patch):
    return patch - patch.mean(axis=(0, 1))


def descended(image1, image2, y, x, start, patch, steps):
    """Return the final position of the patch at (y, x) from the update equation, with the mean of both patches
    subtracted.
    """
    window = np.s_[y : y + patch, x : x + patch]
    slope = np.stack([centred(s[window]).ravel() for s in central(image1)])
    u = np.array(start, float)
    border = patch + 3
    around = np.pad(image2, ((border, border), (border, border), (0, 0)), mode="edge")
    rows, columns = np.mgrid[y : y + patch, x : x + patch] + border
    for _ in range(steps):
        residual = centred(cubic(around, rows + u[1], columns + u[0])) - centred(image1[window])
        step = np.linalg.solve(slope @ slope.T, slope @ residual.ravel())
        u -= step
        if np.hypot(*step) < 1e-3:
            break
    return u


def mismatch(image1, image2, y, x, u, patch):
    looked = linear(image2, y + np.arange(patch) + u[1], x + np.arange(patch) + u[0])
    return float((centred(looked - image1[y : y + patch, x : x + patch]) ** 2).sum())

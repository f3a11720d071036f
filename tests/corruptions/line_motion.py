"""Linear motion blur in float64, tap by tap."""

import math

import numpy as np


def moved_along_a_line(image, radius, sigma, angle):
    """Sum over the taps: tap i is the image shifted back by i pixels along the angle, with replicated borders."""
    taps = np.arange(2 * radius + 1)
    weights = np.exp(-(taps**2) / (2 * sigma**2))
    height, width = image.shape[:2]
    total = np.zeros(image.shape)
    for i, weight in zip(taps, weights / weights.sum(), strict=True):
        dy, dx = (math.ceil(i * way(math.radians(angle)) - 0.5) for way in (math.sin, math.cos))
        rows, columns = (np.clip(np.arange(n) + d, 0, n - 1) for n, d in ((height, dy), (width, dx)))
        total += weight * image[rows][:, columns]
    return total

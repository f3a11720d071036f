"""Textured frames."""

import numpy as np


def picture(height, width, seed=0):
    """A textured frame: a coarse pattern with fine noise on it, some of it black and white."""
    rng = np.random.default_rng([seed, height, width])
    coarse = rng.integers(-40, 296, (height // 8 + 1, width // 8 + 1, 3))
    tiled = coarse.repeat(8, axis=0).repeat(8, axis=1)[:height, :width]
    return np.clip(tiled + rng.integers(-20, 21, tiled.shape), 0, 255).astype(np.uint8)

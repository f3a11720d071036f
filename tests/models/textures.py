"""Pairs of frames, for networks with random weights and networks whose flow is a copy of their input."""

import cv2
import numpy as np


def textured_pair(height, width, seed=0):
    """A pair of frames with a smooth texture that moves two pixels to the right."""
    rng = np.random.default_rng(seed)
    texture = cv2.resize(rng.integers(0, 256, (height // 4, width // 4 + 2, 3)).astype(np.uint8), (width + 8, height))
    return np.ascontiguousarray(texture[:, 4:-4]), np.ascontiguousarray(texture[:, 2:-6])


def noise_pair(height=13, width=19, seed=0):
    """A pair of frames of any size with noise that moves three pixels to the right."""
    texture = np.random.default_rng(seed).integers(0, 256, (height, width + 3, 3)).astype(np.uint8)
    return np.ascontiguousarray(texture[:, 3:]), np.ascontiguousarray(texture[:, :-3])


def channel_flow(first, second):
    """The flow whose u is the first channel of frame 1, and whose v is the third channel of frame 2."""
    return np.stack([first[..., 0], second[..., 2]], 2)

"""Frames of noise, textured frames with depth, and linear motion blur in float64."""

import math

import numpy as np

from robustflow.core.types import Camera, SceneDepth


def noise(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def picture(height, width, seed=0):
    """Return a textured frame: a coarse pattern with fine noise and some black and white areas."""
    rng = np.random.default_rng([seed, height, width])
    coarse = rng.integers(-40, 296, (height // 8 + 1, width // 8 + 1, 3))
    tiled = coarse.repeat(8, axis=0).repeat(8, axis=1)[:height, :width]
    return np.clip(tiled + rng.integers(-20, 21, tiled.shape), 0, 255).astype(np.uint8)


def scene(height, width, seed=0, moves=(0.1, 0.0, -0.4)):
    """Return a wall of blocks at 3 to 60 m, the same in both frames, in front of a slowly moving camera."""
    rng = np.random.default_rng([seed, height, width, 1])
    blocks = rng.uniform(3, 60, (height // 12 + 1, width // 12 + 1)).astype(np.float32)
    depth = np.ascontiguousarray(blocks.repeat(12, axis=0).repeat(12, axis=1)[:height, :width])
    return seen(depth, rotation=np.eye(3), translation=np.array(moves), focal=float(width))


def seen(first, second=None, rotation=None, translation=None, focal=100.0):
    """Return the depth of both frames (the same by default), with the optical axis at the image centre."""
    second = first if second is None else second
    height, width = first.shape
    known = np.ones((height, width), bool)
    camera = Camera((focal, focal), ((width - 1) / 2, (height - 1) / 2), rotation, translation)
    return SceneDepth((first, second), (known, known), camera)


def plane(depth, shape, **camera):
    return seen(np.full(shape, depth, np.float32), **camera)


def ray_lengths(lens, shape):
    """Return the length of each pixel's ray to a plane at a depth of one metre, in float64."""
    fx, fy, cx, cy = lens
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.linalg.norm([(columns - cx) / fx, (rows - cy) / fy, np.ones(shape)], axis=0)


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

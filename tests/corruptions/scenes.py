"""Depth made for tests."""

import numpy as np

from robustflow.sample import Camera, SceneDepth


def scene(first, second=None, rotation=None, translation=None, focal=100.0):
    """The depth of a pair, measured everywhere, before a camera whose axis is in the middle."""
    second = first if second is None else second
    height, width = first.shape
    camera = Camera((focal, focal), ((width - 1) / 2, (height - 1) / 2), rotation, translation)
    return SceneDepth((first, second), (first > 0, second > 0), camera)


def plane(depth, shape, **camera):
    """A fronto-parallel plane in both frames."""
    return scene(np.full(shape, depth, np.float32), **camera)

"""The blur in float64, either with an exact kernel per pixel or with kernels at nodes."""

import math

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.signal import fftconvolve

from robustflow.corruptions.optics.psf_field import Axis, grid_of


def kernel_at(stack, x: float, y: float, height: int, width: int):
    """Return the kernels (3, 61, 61) at the image point (x, y), in pixels from the top left."""
    dx, dy = x - (width - 1) / 2, y - (height - 1) / 2
    distance = math.hypot(dx, dy)
    place = min(distance / (math.hypot(height, width) / 2), 1.0) * (len(stack) - 1)
    lower = min(int(place), len(stack) - 2)
    mixed = stack[lower] + (place - lower) * (stack[lower + 1].astype(float) - stack[lower])
    angle = math.atan2(dx, dy)
    u, v = np.meshgrid(np.arange(-30.0, 31.0), np.arange(-30.0, 31.0))
    along, across = math.cos(angle) * v + math.sin(angle) * u, math.cos(angle) * u - math.sin(angle) * v
    turned = np.stack([map_coordinates(m, [along + 30, across + 30], order=1, mode="grid-constant") for m in mixed])
    return turned / turned.sum((1, 2), keepdims=True)


def padded(frame):
    """Return the image in float64, mirrored at its border pixels."""
    return np.pad(frame.astype(float), ((30, 30), (30, 30), (0, 0)), mode="reflect")


def blurred_pixels(frame, stack, points):
    """Return the blurred values (n, 3) at points (x, y), each with the exact kernel of its place."""
    height, width = frame.shape[:2]
    whole = padded(frame)
    around = [whole[y : y + 61, x : x + 61][::-1, ::-1].transpose(2, 0, 1) for x, y in points]
    kernels = [kernel_at(stack, x, y, height, width) for x, y in points]
    return np.einsum("ncyx,ncyx->nc", kernels, around)


def blended_blur(frame, stack):
    """Convolve the image with the kernel of each node, and sum the results weighted by the nodes' triangular
    windows.
    """
    height, width = frame.shape[:2]
    whole, total = padded(frame), np.zeros(frame.shape)
    axes = [Axis.of(length, grid_of(height, width)) for length in (height, width)]
    places = [(axis.length - 1) / 2 + np.concatenate([-axis.offsets, axis.offsets]) for axis in axes]
    for y in places[0]:
        for x in places[1]:
            windows = [
                np.maximum(1 - np.abs(np.arange(axis.length) - place) / axis.pitch, 0)
                for axis, place in zip(axes, (y, x), strict=True)
            ]
            rows, columns = (slice(window.nonzero()[0].min(), window.nonzero()[0].max() + 1) for window in windows)
            part = whole[rows.start : rows.stop + 60, columns.start : columns.stop + 60]
            kernels = kernel_at(stack, x, y, height, width).transpose(1, 2, 0)
            weights = windows[0][rows, None, None] * windows[1][columns, None]
            total[rows, columns] += weights * fftconvolve(part, kernels, mode="valid", axes=(0, 1))
    return total

"""The blur in float64, either with an exact kernel per pixel or with kernels at nodes."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.signal import fftconvolve

from robustflow.psf.tiles import Axis, grid_of


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


def blurred_pixel(frame, stack, x: int, y: int):
    """Return the blurred value (3,) of one pixel; the image is mirrored at its border pixels."""
    height, width = frame.shape[:2]
    padded = np.pad(frame.astype(float), ((30, 30), (30, 30), (0, 0)), mode="reflect")
    around = padded[y : y + 61, x : x + 61][::-1, ::-1].transpose(2, 0, 1)
    return (kernel_at(stack, x, y, height, width) * around).sum((1, 2))


def blended_blur(frame, stack):
    """Convolve the image with the kernel of each node, and sum the results weighted by the nodes' triangular
    windows.
    """
    height, width = frame.shape[:2]
    padded = np.pad(frame.astype(float), ((30, 30), (30, 30), (0, 0)), mode="reflect")
    total = np.zeros(frame.shape)
    axes = [Axis.of(length, grid_of(height, width)) for length in (height, width)]
    places = [(axis.length - 1) / 2 + np.concatenate([-axis.offsets, axis.offsets]) for axis in axes]
    for y in places[0]:
        for x in places[1]:
            kernels = kernel_at(stack, x, y, height, width)
            weight_y = np.maximum(1 - np.abs(np.arange(height) - y) / axes[0].pitch, 0)
            weight_x = np.maximum(1 - np.abs(np.arange(width) - x) / axes[1].pitch, 0)
            for channel in range(3):
                blurred = fftconvolve(padded[..., channel], kernels[channel], mode="valid")
                total[..., channel] += weight_y[:, None] * weight_x * blurred
    return total

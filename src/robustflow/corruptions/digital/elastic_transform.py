"""Apply an elastic transform: warp both frames by the same smooth random field."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.compiled import contiguous, njit
from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption
from ..kernels.fields import SmoothField, field_row, smooth_field
from ..kernels.filters import mirrored_with_edge

_BITS = 11
"""Fractional bits of positions; a weight is the product of two fractions, and weight times pixel is less than 2**31."""


class ElasticState(NamedTuple):
    """Displacement field in pixels: out[y, x] = in[y + dy, x + dx]."""

    dy: SmoothField
    dx: SmoothField


class ElasticTransform(Corruption):
    """Warps both frames by the same smooth random field (paper, appendix "Corruption Details", digital).

    The severity parameter is alpha. The displacements are alpha times uniform noise in +-0.05 H, blurred with a
    Gaussian whose standard deviation is 0.01 H vertically and 0.01 W horizontally, cut off at three standard
    deviations. The reference code uses +-0.005 H instead (`variant="reference"`). Sampling is bilinear; borders mirror
    the image and repeat the edge pixel. The field folds (at 375x1242, over 19 to 39 % of the pixels),
    so the true flow has no counterpart in the corrupted frames. The corruption is described in the paper's appendix but
    excluded from its averages.
    """

    name = "elastic_transform"
    family = "digital"
    truth = "none"
    paper_severities = (12.5, 16.25, 21.25, 25.0, 30.0)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> ElasticState:
        height, width = shape
        amplitude = self.parameter(severity) * height * (0.005 if self.variant == "reference" else 0.05)
        sigmas = 0.01 * height, 0.01 * width
        return ElasticState(
            smooth_field(rng.spawn("dy"), shape, sigmas, amplitude),
            smooth_field(rng.spawn("dx"), shape, sigmas, amplitude),
        )

    def apply(self, frame: Frame, state: ElasticState, index: int) -> Frame:
        frame = contiguous(frame)
        out = np.empty_like(frame)
        _warp(frame, *state.dy, state.dx.samples, out)
        return out


@njit(cache=True, nogil=True)
def _warp(frame: Any, samples_y: Any, steps: Any, samples_x: Any, out: Any) -> None:
    """Warp in integer arithmetic with positions rounded to 1/2048 px, which changes values by at most 1/8 grey
    level.
    """
    height, width = frame.shape[:2]
    pixels = frame.reshape(-1)
    dy, dx = np.empty(width, np.float32), np.empty(width, np.float32)
    one, half = np.uint32(1 << _BITS), np.uint32(1 << (2 * _BITS - 1))
    for y in range(height):
        field_row(samples_y, steps, y, dy)
        field_row(samples_x, steps, y, dx)
        target = out[y]
        for x in range(width):
            down = np.int64(np.rint(dy[x] * np.float32(1 << _BITS)))
            right = np.int64(np.rint(dx[x] * np.float32(1 << _BITS)))
            top, left = y + (down >> _BITS), x + (right >> _BITS)
            bottom, far = top + 1, left + 1
            if top < 0 or bottom >= height or left < 0 or far >= width:
                top, bottom = mirrored_with_edge(top, height), mirrored_with_edge(bottom, height)
                left, far = mirrored_with_edge(left, width), mirrored_with_edge(far, width)
            a, b = np.uint64(3 * (top * width + left)), np.uint64(3 * (top * width + far))
            c, d = np.uint64(3 * (bottom * width + left)), np.uint64(3 * (bottom * width + far))
            fy, fx = np.uint32(down & ((1 << _BITS) - 1)), np.uint32(right & ((1 << _BITS) - 1))
            wd = np.uint32(fx * fy)
            wc, wb = np.uint32(fy * one - wd), np.uint32(fx * one - wd)
            wa = np.uint32(one * one - wb - wc - wd)
            for channel in range(3):
                k = np.uint64(channel)
                upper = np.uint32(pixels[a + k] * wa + pixels[b + k] * wb)
                lower = np.uint32(pixels[c + k] * wc + pixels[d + k] * wd)
                target[x, channel] = np.uint8(np.uint32(upper + lower + half) >> np.uint32(2 * _BITS))

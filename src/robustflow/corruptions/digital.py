"""The "digital" family of corruptions (paper, appendix "Digital corruptions")."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ..core.compiled import contiguous, njit
from ..core.errors import RobustFlowError
from ..core.rng import Rng
from ..core.types import Frame
from .corruption import Corruption
from .kernels.fields import SmoothField, field_row, smooth_field
from .kernels.filters import mirrored_with_edge, to_bytes


class JpegCompression(Corruption):
    """Applies baseline JPEG compression with 4:2:0 chroma subsampling; the severity parameter is the quality (paper,
    "JPEG compression").
    """

    name = "jpeg_compression"
    paper_severities = (25, 18, 15, 10, 7)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> int:
        return int(self.parameter(severity))

    def apply(self, frame: Frame, state: int, index: int) -> Frame:
        bgr = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, state])
        if not done:
            raise RobustFlowError(f"OpenCV cannot encode a JPEG of {frame.shape[0]}x{frame.shape[1]} pixels")
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB, dst=decoded)


class Pixelate(Corruption):
    """Shrinks frames with a box filter and enlarges them; the severity parameter is the scale factor (paper,
    "Pixelation").

    The result is bit-identical to Pillow: a box filter weights its n pixels equally, so an output pixel is
    (sum * round(2**22 / n) + 2**21) >> 22. Columns are downscaled first, then rows, with 8-bit intermediate values (as
    in Pillow 10; for tall images, Pillow 13 starts with the rows, and results may differ by one grey level).
    """

    name = "pixelate"
    paper_severities = (0.6, 0.5, 0.4, 0.3, 0.25)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        return pixelated(frame, state)


_HALF = 1 << 21


class _AxisResize(NamedTuple):
    """Index tables for downscaling an axis from `size` to `small` pixels and upscaling it again."""

    first: npt.NDArray[np.int64]  # (small,) first pixel in the box
    covered: npt.NDArray[np.int64]  # (small,) number of pixels in the box
    weight: npt.NDArray[np.uint32]  # (small,) round(2**22 / covered)
    nearest: npt.NDArray[np.int64]  # (size,) nearest pixel of the small axis


@lru_cache(maxsize=64)
def _axis_resize(size: int, small: int) -> _AxisResize:
    scale = size / small
    centre = (np.arange(small) + 0.5) * scale
    first = np.maximum((centre - 0.5 * scale + 0.5).astype(np.int64), 0)
    last = np.minimum((centre + 0.5 * scale + 0.5).astype(np.int64), size) - 1
    first += (first - centre + 0.5) / scale <= -0.5
    last -= (last - centre + 0.5) / scale > 0.5
    covered = last - first + 1
    step = np.full(size, small / size)
    step[0] *= 0.5
    nearest = np.minimum(np.add.accumulate(step).astype(np.int64), small - 1)
    return _AxisResize(first, covered, np.floor(2.0**22 / covered + 0.5).astype(np.uint32), nearest)


def pixelated(frame: Frame, factor: float) -> Frame:
    """Downscale `frame`, uint8 (H, W, 3), to int(factor * size) with a box filter and upscale it again."""
    height, width = frame.shape[:2]
    rows = _axis_resize(height, max(1, int(height * factor)))
    columns = _axis_resize(width, max(1, int(width * factor)))
    narrow = np.empty((height, 3 * columns.first.size), np.uint8)
    fewest = int(columns.covered.min())
    most = int(columns.covered.max())
    picks = (columns.covered - fewest) * 3 * width + 3 * columns.first
    weights = np.array([columns.weight[columns.covered == n][:1].sum() for n in range(fewest, most + 1)], np.uint32)
    source = np.require(frame, requirements=("C", "W")).reshape(height, -1)
    sums, means = np.empty(3 * width, np.uint32), np.empty(weights.size * 3 * width, np.uint8)
    _shrink_columns(source, picks, fewest, weights, sums, means, narrow)
    small = np.empty((rows.first.size, narrow.shape[1]), np.uint8)
    _shrink_rows(narrow, rows.first, rows.covered, rows.weight, sums[: narrow.shape[1]], small)
    out = np.empty((height, 3 * width), np.uint8)
    _grow(small, rows.nearest, columns.nearest, out)
    return out.reshape(height, width, 3)


@njit(cache=True, nogil=True)
def _shrink_columns(source: Any, picks: Any, fewest: Any, weights: Any, sums: Any, means: Any, out: Any) -> None:
    """Compute box sums of every required width at every position in a loop that vectorises, then select the required
    sums.
    """
    width = sums.size
    for y in range(source.shape[0]):
        s = source[y]
        sums[:] = 0
        for n in range(1, fewest + weights.size):
            tail = s[3 * (n - 1) :]
            for x in range(tail.size):
                sums[x] += tail[x]
            if n >= fewest:
                weight, begin = weights[n - fewest], (n - fewest) * width
                mean = means[begin : begin + width]
                for x in range(width):
                    mean[x] = (sums[x] * weight + np.uint32(_HALF)) >> np.uint32(22)
        o = out[y]
        for i in range(picks.size):
            p, q = means[picks[i] : picks[i] + 3], o[3 * i : 3 * i + 3]
            q[0], q[1], q[2] = p[0], p[1], p[2]


@njit(cache=True, nogil=True)
def _shrink_rows(source: Any, first: Any, count: Any, weight: Any, sums: Any, out: Any) -> None:
    """Weigh the sums of `count` rows from `first` on for each output row; 22 fractional bits, rounded half up."""
    for y in range(out.shape[0]):
        sums[:] = 0
        for n in range(count[y]):
            s = source[first[y] + n]
            for x in range(sums.size):
                sums[x] += s[x]
        o = out[y]
        for x in range(sums.size):
            o[x] = (sums[x] * weight[y] + np.uint32(_HALF)) >> np.uint32(22)


@njit(cache=True, nogil=True)
def _grow(small: Any, rows: Any, columns: Any, out: Any) -> None:
    """Repeat pixels of `small` (h, 3 w); a row equal to the one above is copied from there."""
    for y in range(rows.size):
        o = out[y]
        if y > 0 and rows[y] == rows[y - 1]:
            above = out[y - 1]
            for x in range(o.size):
                o[x] = above[x]
            continue
        s = small[rows[y]]
        for x in range(columns.size):
            p, q = s[3 * columns[x] : 3 * columns[x] + 3], o[3 * x : 3 * x + 3]
            q[0], q[1], q[2] = p[0], p[1], p[2]


class Contrast(Corruption):
    """Reduces the contrast: out = (I - mean) c + mean; the severity parameter is c (paper, "Contrast").

    The mean is computed per channel, as in the reference code; `variant="paper"` uses one mean for the entire frame, as
    in the paper's formula. `variant="reference"` truncates grey levels, as the reference code does.
    """

    name = "contrast"
    paper_severities = (0.4, 0.3, 0.2, 0.1, 0.05)

    def apply(self, frame: Frame, state: float, index: int) -> Frame:
        source = np.ascontiguousarray(frame)
        sums = np.array(cv2.sumElems(source)[:3])
        pixels = source.shape[0] * source.shape[1]
        means = np.full(3, sums.sum() / (3 * pixels)) if self.variant == "paper" else sums / pixels
        levels = (np.arange(256.0)[None, :] - means[:, None]) * state + means[:, None]
        return np.asarray(cv2.LUT(source, to_bytes(levels, self.variant == "reference").T[None]))


class Saturation(NamedTuple):
    """Parameters for one severity: S' = S alpha + beta."""

    alpha: float
    beta: float


class Saturate(Corruption):
    """Changes the saturation in HSV: S' = S alpha + beta; the severity parameters are (alpha, beta) (paper,
    "Saturate").

    The reference code swaps the first two severities and truncates grey levels (`variant="reference"`). Hue and V are
    unchanged, so a channel c becomes V - V S' (V - c) / (V - m), where V = max(R, G, B) and m = min(R, G, B). Grey has
    a hue of 0, so it turns red if beta > 0.
    """

    name = "saturate"
    level = Saturation
    paper_severities = ((0.1, 0.0), (0.3, 0.0), (2.0, 0.0), (5.0, 0.1), (20.0, 0.2))

    def severities_of(self, variant: str) -> tuple[Any, ...]:
        first, second, *rest = self.paper_severities
        return (second, first, *rest) if variant == "reference" else self.paper_severities

    def apply(self, frame: Frame, state: Saturation, index: int) -> Frame:
        source = np.require(frame, requirements=("C", "W"))
        out = np.empty_like(source)
        alpha, beta = (np.float32(10.0 * value) for value in state)
        _saturate(source.reshape(-1), alpha, beta, self.variant == "reference", out.reshape(-1))
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def _saturate(source: Any, alpha: Any, beta: Any, floor: bool, out: Any) -> None:
    """Change the saturation; `alpha` and `beta` are float32 and ten times the paper's values."""
    ten, one, zero = np.float32(10), np.float32(1), np.float32(0)
    # Adding and subtracting 2**23 rounds to an integer, half to even; the conversion to an integer truncates.
    half_even = zero if floor else np.float32(2**23)
    for i in range(source.size // 3):
        r, g, b = np.float32(source[3 * i]), np.float32(source[3 * i + 1]), np.float32(source[3 * i + 2])
        value = max(r, max(g, b))
        delta = value - min(r, min(g, b))
        grey = one if delta == zero else zero
        chroma = min(ten * value, alpha * delta + beta * value)  # 10 V S'
        scale = ten * (delta + grey)
        r = value - chroma * (value - r) / scale
        g = value - chroma * (value - g + grey) / scale
        b = value - chroma * (value - b + grey) / scale
        out[3 * i] = np.uint8(np.int32(r + half_even - half_even))
        out[3 * i + 1] = np.uint8(np.int32(g + half_even - half_even))
        out[3 * i + 2] = np.uint8(np.int32(b + half_even - half_even))


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

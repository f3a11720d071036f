"""Convert an RGB image to the light on the sensor's pixels, and a RAW image back to RGB.

Each pixel records one colour of the RGGB pattern. Demosaicing follows Malvar, He and Cutler ("High-quality linear
interpolation for demosaicing of Bayer-patterned color images", ICASSP 2004). Before demosaicing, the RAW image is
denoised with a bilateral filter over the eight nearest pixels of the same colour. Its range weight is Tukey's biweight
instead of a Gaussian (Durand and Dorsey, SIGGRAPH 2002); the width depends on the sensor's noise at that brightness.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...compiled import njit
from ...images.contiguous import contiguous
from ...sample import Frame
from ..kernels.borders import mirrored
from .camera import CameraColours, bytes_of_linear, linear_of_bytes
from .exposure import BLACK, WHITE, Light, Raw, Sensor

KNEE = 0.9
"""Linear value above which the white balance fades out, so that white saturates all channels."""
_PAD = 4
"""Padding in pixels: 2 for denoising and 2 for demosaicing; even, so that the Bayer pattern is preserved."""
_WIDTH = 12.0
"""Squared difference at which a neighbour's weight reaches zero, in units of the noise variance of one pixel."""


def light_on_sensor(frame: Frame, camera: CameraColours) -> Light:
    """Convert an RGB frame, uint8 (H, W, 3), to light on the sensor as a fraction of saturation, float32 (H, W)."""
    source = contiguous(frame)
    out = np.empty(source.shape[:2], np.float32)
    _mosaic(source, linear_of_bytes(), *_single(camera.from_srgb, camera.gains), out)
    return out


def developed(raw: Raw, camera: CameraColours, denoise: Sensor | None) -> Frame:
    """Develop a RAW image.

    Args:
        raw: RAW image, uint16 (H, W), from 0 to the white level.
        camera: camera that recorded the RAW image.
        denoise: noise parameters for denoising, or None to skip denoising.

    Returns:
        RGB uint8 (H, W, 3).
    """
    height, width = raw.shape
    linear = np.empty((height + 2 * _PAD, width + 2 * _PAD), np.float32)
    _pad(raw, np.float32(BLACK), np.float32(1.0 / (WHITE - BLACK)), linear)
    matrix, gains = _single(camera.to_srgb, camera.gains)
    if denoise is not None:
        noisy, linear = linear, np.empty_like(linear)
        _denoise(noisy, np.float32(_WIDTH * denoise.shot), np.float32(_WIDTH * denoise.read**2), linear)
    _balance(linear, gains)
    out = np.empty((height, width, 3), np.uint8)
    _demosaic(linear, matrix, bytes_of_linear(), out)
    return out


def _single(*arrays: Any) -> tuple[Any, ...]:
    return tuple(array.astype(np.float32) for array in arrays)


@njit(cache=True, nogil=True)
def _mosaic(frame: Any, light: Any, matrix: Any, gains: Any, out: Any) -> None:
    one, knee = np.float32(1.0), np.float32(KNEE)
    slope = np.float32(1.0 / (1.0 - KNEE))
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            colour = (y & 1) + (x & 1)
            m, gain = matrix[colour], gains[colour]
            pixel = frame[y, x]
            value = m[0] * light[pixel[0]] + m[1] * light[pixel[1]] + m[2] * light[pixel[2]]
            beyond = max(value - knee, np.float32(0.0)) * slope
            out[y, x] = min(gain * value + (one - gain) * beyond * beyond, one)


@njit(cache=True, nogil=True)
def _pad(raw: Any, black: Any, scale: Any, out: Any) -> None:
    height, width = raw.shape
    for y in range(out.shape[0]):
        row, target = raw[mirrored(y - _PAD, height)], out[y]
        for x in range(width):
            target[x + _PAD] = (np.float32(row[x]) - black) * scale
        for x in range(_PAD):
            target[x] = target[_PAD + mirrored(x - _PAD, width)]
            target[width + _PAD + x] = target[_PAD + mirrored(width + x, width)]


@njit(cache=True, nogil=True, error_model="numpy")
def _denoise(noisy: Any, shot: Any, read: Any, out: Any) -> None:
    """Denoise a RAW image, except for a border of two pixels; `shot` and `read` are in units of squared difference."""
    size = noisy.shape[1] - 4
    for y in range(noisy.shape[0] - 4):
        top, above, here = noisy[y], noisy[y + 1], noisy[y + 2]
        below, bottom, target = noisy[y + 3], noisy[y + 4], out[y + 2]
        for x in range(size):
            a, b, c, d = above[x + 1], above[x + 3], below[x + 1], below[x + 3]
            e, f, g, h = top[x], top[x + 4], bottom[x], bottom[x + 4]
            green = ((x + y) & 1) == 1  # the next four neighbours are diagonal
            a, b, c, d = a if green else e, b if green else f, c if green else g, d if green else h
            target[x + 2] = _mean_of_alike(
                here[x + 2], a, b, c, d, top[x + 2], bottom[x + 2], here[x], here[x + 4], shot, read
            )


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _mean_of_alike(v: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, shot: Any, read: Any) -> Any:
    """Return the similarity-weighted mean of v and its neighbours."""
    one, zero = np.float32(1.0), np.float32(0.0)
    mean = (((a + b) + (c + d)) + ((e + f) + (g + h)) + v) * np.float32(1.0 / 9.0)
    scale = one / (shot * max(mean, zero) + read)
    a, b, c, d, e, f, g, h = a - v, b - v, c - v, d - v, e - v, f - v, g - v, h - v
    wa, wb = max(one - a * a * scale, zero), max(one - b * b * scale, zero)
    wc, wd = max(one - c * c * scale, zero), max(one - d * d * scale, zero)
    we, wf = max(one - e * e * scale, zero), max(one - f * f * scale, zero)
    wg, wh = max(one - g * g * scale, zero), max(one - h * h * scale, zero)
    wa, wb, wc, wd, we, wf, wg, wh = wa * wa, wb * wb, wc * wc, wd * wd, we * we, wf * wf, wg * wg, wh * wh
    total = ((wa * a + wb * b) + (wc * c + wd * d)) + ((we * e + wf * f) + (wg * g + wh * h))
    return v + total / (one + (((wa + wb) + (wc + wd)) + ((we + wf) + (wg + wh))))


@njit(cache=True, nogil=True, error_model="numpy")
def _balance(linear: Any, gains: Any) -> None:
    """Invert the gains of `_mosaic`, in place."""
    one, knee = np.float32(1.0), np.float32(KNEE)
    slope = np.float32(1.0 / (1.0 - KNEE))
    own = np.empty((2, linear.shape[1]), np.float32)  # gains for pixels in even and odd rows
    for y in range(2):
        for x in range(own.shape[1]):
            own[y, x] = gains[y + (x & 1)]
    for y in range(linear.shape[0]):
        row, gain_row = linear[y], own[y & 1]
        for x in range(row.size):
            gain = gain_row[x]
            limit = gain * knee
            beyond = max(row[x] - limit, np.float32(0.0))
            root = np.sqrt(gain * gain + np.float32(4.0) * (one - gain) * slope * slope * beyond)
            row[x] = min(row[x], limit) * (one / gain) + np.float32(2.0) * beyond / (gain + root)


@njit(cache=True, nogil=True)
def _demosaic(linear: Any, matrix: Any, shown: Any, out: Any) -> None:
    height, width = out.shape[:2]
    eighth, half, three_halves = np.float32(0.125), np.float32(0.5), np.float32(1.5)
    two, four, five, six = np.float32(2.0), np.float32(4.0), np.float32(5.0), np.float32(6.0)
    colours = np.empty((3, width + 1), np.float32)
    rows = np.empty((3, width), np.int32)
    for y in range(height):
        top, above, here, below, bottom = linear[y + 2], linear[y + 3], linear[y + 4], linear[y + 5], linear[y + 6]
        own, other = colours[2 * (y & 1)], colours[2 - 2 * (y & 1)]
        green = colours[1]
        for x in range(width):
            centre = here[x + 4]
            across, along = above[x + 4] + below[x + 4], here[x + 3] + here[x + 5]
            corners = (above[x + 3] + above[x + 5]) + (below[x + 3] + below[x + 5])
            far_across, far_along = top[x + 4] + bottom[x + 4], here[x + 2] + here[x + 6]
            far = far_across + far_along
            at_own = (four * centre + two * (across + along) - far) * eighth
            opposite = (six * centre + two * corners - three_halves * far) * eighth
            along_row = (five * centre + four * along - far_along - corners + half * far_across) * eighth
            across_rows = (five * centre + four * across - far_across - corners + half * far_along) * eighth
            is_green = ((x + y) & 1) == 1
            green[x] = centre if is_green else at_own
            own[x] = along_row if is_green else centre
            other[x] = across_rows if is_green else opposite
        for channel in range(3):
            m, target = matrix[channel], rows[channel]
            for x in range(width):
                value = m[0] * colours[0, x] + m[1] * colours[1, x] + m[2] * colours[2, x]
                value = min(max(value, np.float32(0.0)), np.float32(1.0)) * np.float32(shown.size)
                target[x] = min(np.int32(value), np.int32(shown.size - 1))
        for x in range(width):
            out[y, x, 0] = shown[rows[0, x]]
            out[y, x, 1] = shown[rows[1, x]]
            out[y, x, 2] = shown[rows[2, x]]

"""Sensor noise, simulated with the complete processing pipeline of a camera.

Each pixel records one colour of the RGGB pattern. Demosaicing follows Malvar, He and Cutler ("High-quality linear
interpolation for demosaicing of Bayer-patterned color images", ICASSP 2004). Before demosaicing, the RAW image is
denoised with a bilateral filter over the eight nearest pixels of the same colour. Its range weight is Tukey's biweight
instead of a Gaussian (Durand and Dorsey, SIGGRAPH 2002); the width depends on the sensor's noise at that brightness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.compiled import contiguous, inner, njit
from ...core.rng import Rng
from ...core.types import Frame
from ..corruption import Corruption
from ..kernels.filters import mirrored
from .camera import (
    BLACK,
    NOISELESS,
    WHITE,
    CameraColours,
    Light,
    Raw,
    Sensor,
    bytes_of_linear,
    draw_camera,
    exposed,
    exposed_without_noise,
    linear_of_bytes,
    sensor_at,
)


@dataclass(frozen=True)
class RawState:
    """State for a pair: the camera and its noise parameters; `stream` is the parent of both frames' random streams."""

    camera: CameraColours
    sensor: Sensor
    stream: Rng


class RawNoise(Corruption):
    """Simulates capturing the frames with a noisy sensor; severities are ISO numbers.

    Each frame is converted back to the light on the sensor (`camera`, `mosaic`), exposed with photon and read noise
    (`exposure`), and developed again: denoising, white balance, demosaicing, colours, gamma and tone curve. The
    difference from a development without noise and denoising is added to the frame, because the frame has been
    demosaiced before: without noise it stays as it is. The camera and its gains are drawn once per pair; the noise is
    independent in each frame. This corruption is excluded from the paper's averages.
    """

    name = "raw_noise"
    paper_severities = (800, 1600, 3200, 6400, 12800)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> RawState:
        return RawState(draw_camera(rng.spawn("camera")), sensor_at(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: RawState, index: int) -> Frame:
        key = np.uint64(state.stream.spawn("frame", index).key)
        light = light_on_sensor(frame, state.camera)
        noisy = developed(exposed(light, state.sensor, key), state.camera, state.sensor)
        clean = developed(exposed_without_noise(light), state.camera, NOISELESS)
        return np.clip(frame + (noisy.astype(np.int16) - clean), 0, 255).astype(np.uint8)


KNEE = 0.9
"""Linear value above which the white balance fades out, so that white saturates all channels."""
_PAD = 4
"""Padding in pixels: 2 for denoising and 2 for demosaicing; even, so that the Bayer pattern is preserved."""
_RING = 8
"""Number of rows kept in memory per step."""
_WIDTH = 12.0
"""Squared difference at which a neighbour's weight reaches zero, in units of the noise variance of one pixel."""


def _eighths(*weights: float) -> tuple[np.float32, ...]:
    return tuple(np.float32(weight / 8) for weight in weights)


_GREEN_AT_COLOUR = _eighths(4, 2, 2, 0, -1, -1)
_OTHER_AT_COLOUR = _eighths(6, 0, 0, 2, -1.5, -1.5)
_OWN_AT_GREEN = _eighths(5, 4, 0, -1, -1, 0.5)
_OTHER_AT_GREEN = _eighths(5, 0, 4, -1, 0.5, -1)
"""Weights of Malvar, He and Cutler for `_filter`; "own" is the colour in the same row as the green pixels."""


def light_on_sensor(frame: Frame, camera: CameraColours) -> Light:
    """Convert an RGB frame, uint8 (H, W, 3), to light on the sensor as a fraction of saturation, float32 (H, W)."""
    source = contiguous(frame)
    out = np.empty(source.shape[:2], np.float32)
    _mosaic(source, linear_of_bytes(), *_as_float32(camera.from_srgb, camera.gains), out)
    return out


def developed(raw: Raw, camera: CameraColours, sensor: Sensor) -> Frame:
    """Develop a RAW image."""
    matrix, gains = _as_float32(camera.to_srgb, camera.gains)
    noise = np.float32(_WIDTH * sensor.shot), np.float32(_WIDTH * sensor.read**2)
    out = np.empty((*raw.shape, 3), np.uint8)
    _develop(raw, *noise, gains, matrix, bytes_of_linear(), out)
    return out


def _as_float32(*arrays: Any) -> tuple[Any, ...]:
    return tuple(array.astype(np.float32) for array in arrays)


@njit(cache=True, nogil=True)
def _mosaic(frame: Any, light: Any, matrix: Any, gains: Any, out: Any) -> None:
    """Compute the light (H, W) of an RGGB sensor; above the knee, the gains fade, so that white stays white."""
    one, knee = np.float32(1.0), np.float32(KNEE)
    slope = np.float32(1.0 / (1.0 - KNEE))
    for y in range(out.shape[0]):
        pixels, row = frame[y], out[y]
        for parity in range(2):
            colour = (y & 1) + parity
            red, green, blue, gain = matrix[colour, 0], matrix[colour, 1], matrix[colour, 2], gains[colour]
            for x in range(np.uint64(parity), np.uint64(row.size), np.uint64(2)):
                row[x] = red * light[pixels[x, 0]] + green * light[pixels[x, 1]] + blue * light[pixels[x, 2]]
            for x in range(parity, row.size, 2):
                beyond = max(row[x] - knee, np.float32(0.0)) * slope
                row[x] = min(gain * row[x] + (one - gain) * beyond * beyond, one)


@njit(cache=True, nogil=True)
def _develop(raw: Any, shot: Any, read: Any, gains: Any, matrix: Any, shown: Any, out: Any) -> None:
    """Develop a RAW image row by row; it is not denoised if `read` is zero."""
    height, width = raw.shape
    noisy = np.empty((_RING, 2, width // 2 + 1 + _PAD), np.float32)
    linear = np.empty_like(noisy) if read > 0 else noisy
    colours = np.empty((3, width // 2 + 1), np.float32)
    places = np.empty((3, width // 2 + 1), np.uint32)
    for y in range(height + 2 * _PAD):
        _pad(raw[mirrored(y - _PAD, height)], noisy[y % _RING])
        if y < _PAD:
            continue
        if read > 0:
            _denoise(noisy, y - 2, shot, read, linear[(y - 2) % _RING])
        for parity in range(2):
            _balance(linear[(y - 2) % _RING, parity], gains[(y & 1) + parity])
        if y >= 2 * _PAD:
            _demosaic(linear, y - _PAD, matrix, shown, colours, places, out[y - 2 * _PAD])


@inner
def _pad(row: Any, out: Any) -> None:
    """Convert a row of a RAW image to light, separate the even and odd columns, and pad both."""
    black, scale, width = np.float32(BLACK), np.float32(1.0 / (WHITE - BLACK)), row.size
    for parity in range(2):
        target, first = out[parity, _PAD // 2 :], np.uint64(parity)
        size = (width + 1 - parity) // 2
        for i in range(np.uint64(size)):
            target[i] = (np.float32(row[np.uint64(2) * i + first]) - black) * scale
        for i in range(size, target.size):
            target[i] = (np.float32(row[mirrored(2 * i + parity, width)]) - black) * scale
        for i in range(_PAD // 2):
            out[parity, i] = (np.float32(row[mirrored(2 * i + parity - _PAD, width)]) - black) * scale


@njit(cache=True, nogil=True, error_model="numpy")
def _denoise(noisy: Any, y: int, shot: Any, read: Any, out: Any) -> None:
    """Denoise row `y` of the ring buffer, except for the outermost columns."""
    last = out.shape[1] - 1
    for parity in range(2):
        top, here, bottom = noisy[(y - 2) % _RING, parity], noisy[y % _RING, parity], noisy[(y + 2) % _RING, parity]
        first, right, upper, lower = 0, 2, top, bottom
        if (y + parity) & 1:  # green: the nearest neighbours are diagonal
            first, right = parity, parity + 1
            upper, lower = noisy[(y - 1) % _RING, 1 - parity], noisy[(y + 1) % _RING, 1 - parity]
        nearest, farther = (upper[first:], upper[right:], lower[first:], lower[right:]), (top[1:], bottom[1:])
        _average_alike(here[1:last], nearest, (*farther, here, here[2:]), shot, read, out[parity, 1:last])


@njit(cache=True, nogil=True, error_model="numpy")
def _average_alike(here: Any, nearest: Any, farther: Any, shot: Any, read: Any, out: Any) -> None:
    """Compute the mean of each pixel and its eight neighbours, weighted by similarity."""
    (a, b, c, d), (e, f, g, h) = nearest, farther
    for i in range(here.size):
        v = here[i]
        mean = (((a[i] + b[i]) + (c[i] + d[i])) + ((e[i] + f[i]) + (g[i] + h[i])) + v) * np.float32(1.0 / 9.0)
        width = shot * max(mean, np.float32(0.0)) + read  # the weights are scaled by width**2
        da, db, dc, dd, de, df, dg, dh = a[i] - v, b[i] - v, c[i] - v, d[i] - v, e[i] - v, f[i] - v, g[i] - v, h[i] - v
        wa, wb, wc, wd = _similarity(da, width), _similarity(db, width), _similarity(dc, width), _similarity(dd, width)
        we, wf, wg, wh = _similarity(de, width), _similarity(df, width), _similarity(dg, width), _similarity(dh, width)
        total = ((wa * da + wb * db) + (wc * dc + wd * dd)) + ((we * de + wf * df) + (wg * dg + wh * dh))
        out[i] = v + total / (width * width + (((wa + wb) + (wc + wd)) + ((we + wf) + (wg + wh))))


@njit(cache=True, nogil=True, inline="always")
def _similarity(difference: Any, width: Any) -> Any:
    """Return the weight for a difference between neighbours."""
    rest = max(width - difference * difference, np.float32(0.0))
    return rest * rest


@njit(cache=True, nogil=True, error_model="numpy")
def _balance(row: Any, gain: Any) -> None:
    """Undo a gain applied by `_mosaic`, in place."""
    one, knee = np.float32(1.0), np.float32(KNEE)
    slope = np.float32(1.0 / (1.0 - KNEE))
    limit, inverse = gain * knee, one / gain
    for i in range(row.size):
        beyond = max(row[i] - limit, np.float32(0.0))
        root = np.sqrt(gain * gain + np.float32(4.0) * (one - gain) * slope * slope * beyond)
        row[i] = min(row[i], limit) * inverse + np.float32(2.0) * beyond / (gain + root)


@inner
def _demosaic(linear: Any, y: int, matrix: Any, shown: Any, colours: Any, places: Any, out: Any) -> None:
    """Interpolate the colours in row `y` of the ring buffer and convert them to bytes."""
    width = out.shape[0]
    levels, last = np.float32(shown.size), np.int32(shown.size - 1)
    for parity in range(2):
        size = (width + 1 - parity) // 2
        own, other = colours[2 * (y & 1), :size], colours[2 - 2 * (y & 1), :size]
        recorded, centre = own, linear[y % _RING, parity, _PAD // 2 :]
        if (y + parity) & 1:
            recorded = colours[1, :size]
            _filter(linear, y, parity, _OWN_AT_GREEN, own)
            _filter(linear, y, parity, _OTHER_AT_GREEN, other)
        else:
            _filter(linear, y, parity, _GREEN_AT_COLOUR, colours[1, :size])
            _filter(linear, y, parity, _OTHER_AT_COLOUR, other)
        for i in range(size):
            recorded[i] = centre[i]
        for channel in range(3):
            m0, m1, m2, target = matrix[channel, 0], matrix[channel, 1], matrix[channel, 2], places[channel]
            for i in range(size):
                value = m0 * colours[0, i] + m1 * colours[1, i] + m2 * colours[2, i]
                value = min(max(value, np.float32(0.0)), np.float32(1.0)) * levels
                target[i] = np.uint32(min(np.int32(value), last))
        for i in range(np.uint64(size)):
            x = np.uint64(2) * i + np.uint64(parity)
            out[x, 0], out[x, 1], out[x, 2] = shown[places[0, i]], shown[places[1, i]], shown[places[2, i]]


@inner
def _filter(linear: Any, y: int, parity: int, weights: Any, out: Any) -> None:
    """Filter the pixels in row `y` and columns of one parity with 5x5 weights."""
    centre, along, across, diagonal, far_along, far_across = weights
    here, upper, lower = linear[y % _RING], linear[(y - 1) % _RING], linear[(y + 1) % _RING]
    middle, far_left, far_right = here[parity, 2:], here[parity, 1:], here[parity, 3:]
    above, below = upper[parity, 2:], lower[parity, 2:]
    far_above, far_below = linear[(y - 2) % _RING, parity, 2:], linear[(y + 2) % _RING, parity, 2:]
    other, first = 1 - parity, parity + 1
    left, right = here[other, first:], here[other, first + 1 :]
    nw, ne = upper[other, first:], upper[other, first + 1 :]
    sw, se = lower[other, first:], lower[other, first + 1 :]
    for i in range(out.size):
        value = centre * middle[i] + along * (left[i] + right[i]) + across * (above[i] + below[i])
        value += diagonal * ((nw[i] + ne[i]) + (sw[i] + se[i]))
        out[i] = value + (far_along * (far_left[i] + far_right[i]) + far_across * (far_above[i] + far_below[i]))

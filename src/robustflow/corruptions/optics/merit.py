"""Merit function for lens design: least-squares residuals between the blur of a lens and its goal.

A lens is scaled to its focal length, its entrance pupil is found for six field points by aiming four rays each at
the stop, and a grid of rays is traced per wavelength. The following statistics are computed from the landing points of
the rays, without rendering an image:

* the modulation transfer in the tangential and sagittal directions at five frequencies (`FREQUENCIES`): the modulus
  of the mean of exp(-2 pi i f y) over the rays, times the sinc of the pixel;
* the RMS radius, per field and colour, both within a disk of 30 pixels and over all rays.

The edges of the stop and the window are ramps about as wide as the ray spacing, so residuals change smoothly with the
prescription. Cosines are approximated by polynomials: with only + - * / and sqrt, a search takes the same path on every
machine.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.compiled import inner, njit
from .lens import DESIGN_WAVELENGTH, Array, Lens, first_order_of, launched, plane_points, propagate

FIELDS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
"""Field points of the merit function, as fractions of the half diagonal."""

BASE_FREQUENCY = 0.02
FREQUENCIES: Array = BASE_FREQUENCY * np.array([1.0, 2.0, 4.0, 8.0, 16.0])
"""Frequencies in cycles per pixel: 0.02, 0.04, ..., 0.32."""

WINDOW_RADIUS = 30.0
"""Radius in pixels of the disk to which a PSF is clipped, so that it can be rotated within its 61 x 61 array without
loss.
"""

GRID_X, GRID_Y = 7, 14
AIM_TOLERANCE = 0.2
"""Maximum distance between an aimed ray and its target in the stop, in radii of the stop."""
MECHANICAL_WEIGHT = 3.0


class Goal(NamedTuple):
    focal_length: float
    f_number: float
    field_tangent: float
    tangential: Array
    in_phase: Array
    sagittal: Array
    rms: Array
    lateral: Array
    nominal_rms: float


class Limits(NamedTuple):
    """Manufacturing limits in mm."""

    glass_centre: float = 1.5
    glass_edge: float = 1.0
    glass_most: float = 15.0
    air_centre: float = 0.1
    air_edge: float = 0.05
    length: float = 2.5
    back: float = 5.0


LIMITS = Limits()
"""The limits for which lenses are designed."""


@njit(cache=True, error_model="numpy", inline="always")
def _cos_sin_turns(turns: Any) -> tuple[Any, Any]:
    """Return cosine and sine of 2 pi `turns` to within 1e-9, using a polynomial at a quarter of the angle,
    which is then doubled twice.
    """
    a = (turns - np.floor(turns + 0.5)) * (0.5 * np.pi)
    q = a * a
    s = a * (1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72 * (1 - q / 110)))))
    c = 1 - q / 2 * (1 - q / 12 * (1 - q / 30 * (1 - q / 56 * (1 - q / 90))))
    c, s = c * c - s * s, 2 * c * s
    return c * c - s * s, 2 * c * s


@njit(cache=True, error_model="numpy")
def aim(surfaces: Any, stop: int, radius: float, tangents: Any, order: Any) -> Any:
    """Find rays through the centre, top, bottom and side of the stop for each field, using the secant method; return
    their x and y (4 F,), and the largest miss in radii of the stop.
    """
    fields, magnification = tangents.size, order.pupil_magnification
    sign = np.zeros(4 * fields)
    sign[fields : 2 * fields], sign[2 * fields : 3 * fields] = 1.0, -1.0
    tangent = np.empty(4 * fields)
    for f in range(4 * fields):
        tangent[f] = tangents[f % fields]
    x, y = np.zeros(4 * fields), sign * radius * magnification - order.pupil_position * tangent
    x[3 * fields :] = radius * magnification
    no_path = np.empty((0, 3, 0))
    slope = np.full(4 * fields, 1.0 / magnification)
    old_x, old_y, old_miss = x.copy(), y.copy(), np.zeros(4 * fields)
    miss, unbounded = np.zeros(4 * fields), np.full(stop, np.inf)
    for step in range(8):
        rays = launched(x, y, tangent)
        propagate(surfaces, 0, stop, unbounded, rays, no_path)
        at_x, at_y = plane_points(rays)
        for f in range(4 * fields):
            side = f >= 3 * fields
            miss[f] = (at_x[f] - radius) if side else (at_y[f] - sign[f] * radius)
            moved = (x[f] - old_x[f]) if side else (y[f] - old_y[f])
            if step > 0 and abs(moved) > 1e-9:
                secant = (miss[f] - old_miss[f]) / moved
                if 0.2 < secant * magnification < 5.0:
                    slope[f] = secant
            old_x[f], old_y[f], old_miss[f] = x[f], y[f], miss[f]
            if side:
                x[f] -= miss[f] / slope[f]
            else:
                y[f] -= miss[f] / slope[f]
        for f in range(fields):
            y[3 * fields + f] = y[f]
    return x, y, np.abs(miss).max() / radius


def aimed(lens: Lens, tangents: Array) -> Any:
    """Return what `aim` finds for a lens at the design wavelength."""
    return aim(lens.at(DESIGN_WAVELENGTH), lens.stop, lens.stop_radius, tangents, first_order_of(lens))


@njit(cache=True, error_model="numpy")
def landing(
    surfaces: Any, clear: Any, stop: int, radius: float, tangent: float, pupil: Any, grid: Any, ramp: float, margin: Any
) -> Any:
    """Trace a grid of rays, (columns, rows), for one field and wavelength through the half x > 0 of the pupil, which
    extends from bottom to top and to one side; return where they land in mm, their weights, and the weights without
    rims.
    """
    (bottom, top, side), (columns, rows) = pupil, grid
    middle, half, width = 0.5 * (bottom + top), 0.5 * (top - bottom) * margin, side * margin
    x, y = np.empty(columns * rows), np.empty(columns * rows)
    for j in range(rows):
        for i in range(columns):
            x[j * columns + i] = width * (i + 0.5) / columns
            y[j * columns + i] = middle + half * ((2 * j + 1.0) / rows - 1.0)
    no_path = np.empty((0, 3, 0))
    rays = launched(x, y, np.full(x.size, tangent))
    propagate(surfaces, 0, stop, clear, rays, no_path)
    at_x, at_y = plane_points(rays)
    weight = np.empty(x.size)
    for i in range(x.size):
        r = np.sqrt(at_x[i] * at_x[i] + at_y[i] * at_y[i]) / radius
        weight[i] = min(max((1.0 + 0.5 * ramp - r) / ramp, 0.0), 1.0)
    propagate(surfaces, stop, surfaces.curvature.size, clear, rays, no_path)
    sx, sy = plane_points(rays)
    return sx, sy, weight * rays.alive, weight


@inner
def _window(u: float, v: float) -> float:
    return min(max((WINDOW_RADIUS + 1.0 - np.sqrt(u * u + v * v)) * 0.5, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def blur_statistics(
    sx: Any, sy: Any, weight: Any, out_t: Any, out_re: Any, out_s: Any, out_rms: Any, out_mean: Any
) -> float:
    """Compute the transfer (3, 5), RMS radius and centroid (3,) within the window from rays (3 colours, R) in
    pixels.
    """
    colours, count = sx.shape
    centre = 0.0
    for step in range(5):
        total, moment = 0.0, 0.0
        for i in range(count):
            w = weight[1, i]
            if step > 0:
                w *= _window(sx[1, i], sy[1, i] - centre)
            total += w
            moment += w * sy[1, i]
        centre = moment / max(total, 1e-12)
    unbounded = 0.0
    inner, c, s, cs, ss = np.empty(count), np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for colour in range(colours):
        x, y, outer = sx[colour], sy[colour], weight[colour]
        for i in range(count):  # elementwise, so that the compiler can vectorise the loop
            v = y[i] - centre
            inner[i] = outer[i] * _window(x[i], v)
            c[i], s[i] = _cos_sin_turns(BASE_FREQUENCY * v)
            cs[i], ss[i] = _cos_sin_turns(BASE_FREQUENCY * x[i])
        weight_sum, first_moment, second_moment, total, first, second = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            v = y[i] - centre
            squared = x[i] * x[i] + v * v
            weight_sum += outer[i]
            first_moment += outer[i] * v
            second_moment += outer[i] * squared
            total += inner[i]
            first += inner[i] * v
            second += inner[i] * squared
        total, weight_sum = max(total, 1e-12), max(weight_sum, 1e-12)
        mean = out_mean[colour] = first / total
        out_rms[colour] = np.sqrt(max(second / total - mean * mean, 0.0))
        mean = first_moment / weight_sum
        unbounded += np.sqrt(max(second_moment / weight_sum - mean * mean, 0.0))
        frequency = BASE_FREQUENCY
        for k in range(FREQUENCIES.size):
            re, im, sagittal = 0.0, 0.0, 0.0
            for i in range(count):
                re += inner[i] * c[i]
                im += inner[i] * s[i]
                sagittal += inner[i] * cs[i]
            pixel = _cos_sin_turns(0.5 * frequency)[1] / (np.pi * frequency)
            out_t[colour, k] = pixel * np.sqrt(re * re + im * im) / total
            out_re[colour, k] = pixel * re / total
            out_s[colour, k] = pixel * abs(sagittal) / total
            frequency *= 2.0
            for i in range(count):  # double the frequency
                c[i], s[i] = c[i] * c[i] - s[i] * s[i], 2.0 * c[i] * s[i]
                cs[i], ss[i] = cs[i] * cs[i] - ss[i] * ss[i], 2.0 * cs[i] * ss[i]
    return unbounded

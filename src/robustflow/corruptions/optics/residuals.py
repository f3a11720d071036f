"""Compute the residuals of the merit function from the free parameters of a lens and minimise them.

The free parameters are the curvatures of the glass surfaces times the focal length, the gaps divided by the focal
length, and the distance between the sensor and the paraxial focus in mm. The lens is scaled to the goal's focal length
before the residuals are computed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...core.compiled import inner, njit
from .lens import PIXEL, Array, Surfaces, first_order, launched, propagate
from .merit import (
    AIM_TOLERANCE,
    FIELDS,
    GRID_X,
    GRID_Y,
    LIMITS,
    MECHANICAL_WEIGHT,
    Goal,
    aim,
    blur_statistics,
    landing,
)

STEP = 1e-5
PHASE_WEIGHT, RADIUS_WEIGHT, LATERAL_WEIGHT, NOMINAL_WEIGHT = 0.5, 0.5, 0.05, 6.0
"""Weights of the in-phase transfer, relative RMS radius, lateral colour per pixel and relative nominal RMS radius, each
relative to the weight of the modulation.
"""
RIM = 1.03
"""Ratio of a surface's clear radius to the maximum height of the aimed rays at the surface."""


@njit(cache=True, error_model="numpy")
def build_lens(free: Any, index: Any, stop: int, focal_length: float, f_number: float) -> Any:
    """Return the surfaces at the last wavelength, the stop radius (0 for an infeasible lens) and the first-order
    properties.
    """
    count = index.shape[1] - 1
    curvature, thickness = np.zeros(count), np.zeros(count)
    surfaces = Surfaces(curvature, np.zeros(count), thickness, index[-1])
    position = 0
    for k in range(count):
        if k != stop:
            curvature[k] = free[position] / focal_length
            position += 1
    for k in range(count - 1):
        thickness[k] = free[position] * focal_length
        position += 1
    order = first_order(surfaces, stop)
    scale = focal_length / order.focal_length
    if not 0.2 < scale < 5.0:
        return surfaces, 0.0, order
    for k in range(count):
        curvature[k] /= scale
        thickness[k] *= scale
    order = first_order(surfaces, stop)
    thickness[-1] = order.back_focus + free[position]
    radius = focal_length / (2.0 * f_number * order.pupil_magnification)
    if not (0.05 < order.pupil_magnification < 20.0) or thickness[-1] <= 0.0:
        radius = 0.0
    return surfaces, radius, order


@inner
def _sag(c: float, h: float) -> float:
    """Return the sag of a sphere, extrapolated linearly beyond 0.95 of its radius."""
    limit = h if abs(c * h) < 0.95 else 0.95 / abs(c)
    return c * limit * limit / (1.0 + np.sqrt(1.0 - c * c * limit * limit)) + (h - limit) * 3.0 * np.sign(c)


@njit(cache=True, error_model="numpy")
def clear_radii(surfaces: Any, x: Any, y: Any, tangent: Any) -> Any:
    """Return the clear radius of each surface in mm and the number of aimed rays that fail."""
    rays, count = launched(x, y, tangent), surfaces.curvature.size
    path = np.zeros((count, 3, x.size))
    propagate(surfaces, 0, count, np.full(count, np.inf), rays, path)
    radii = np.zeros(count)
    for k in range(count):
        for i in range(x.size):
            radii[k] = max(radii[k], RIM * np.sqrt(path[k, 0, i] ** 2 + path[k, 1, i] ** 2))
    return radii, x.size - rays.alive.sum()


@njit(cache=True, error_model="numpy")
def fill_residuals(free: Any, index: Any, stop: int, goal: Any, limits: Any, out: Any) -> bool:
    """Compute the residuals of a lens; return False if it is infeasible or cannot be traced. `index`
    contains refractive indices, (3 n + 1, K + 1).
    """
    focal_length, f_number, field_tangent, tangential, in_phase, sagittal, wanted_rms, lateral, nominal = goal
    surfaces, radius, order = build_lens(free, index, stop, focal_length, f_number)
    if radius <= 0.0:
        return False
    curvature, conic, thickness, _ = surfaces
    count = FIELDS.size
    tangents = FIELDS * field_tangent
    x, y, miss = aim(surfaces, stop, radius, tangents, order)
    if not miss < AIM_TOLERANCE:
        return False
    radii, missed = clear_radii(surfaces, x, y, np.concatenate((tangents, tangents, tangents, tangents)))
    if missed > 0:
        return False
    clear = radii.copy()
    clear[stop] = np.inf
    samples = (index.shape[0] - 1) // 3
    grid = np.int64(GRID_X), np.int64(GRID_Y)  # for constants, `landing` would be compiled once more
    rays = GRID_X * GRID_Y
    sx, sy, weight = np.empty((3, samples * rays)), np.empty((3, samples * rays)), np.empty((3, samples * rays))
    t, re, s = np.empty((3, 5)), np.empty((3, 5)), np.empty((3, 5))
    rms, mean = np.empty(3), np.empty(3)
    unbounded, position, shadow = 0.0, 0, 0.0
    for f in range(count):
        pupil = y[2 * count + f], y[count + f], x[3 * count + f]
        for w in range(3 * samples):
            at = Surfaces(curvature, conic, thickness, index[w])
            px, py, weights, unblocked = landing(at, clear, stop, radius, tangents[f], pupil, grid, 0.12, 1.06)
            colour, place = w // samples, (w % samples) * rays
            for i in range(rays):
                sx[colour, place + i], sy[colour, place + i] = px[i] / PIXEL, py[i] / PIXEL
                weight[colour, place + i] = weights[i]
                shadow += unblocked[i] - weights[i]
        unbounded += blur_statistics(sx, sy, weight, t, re, s, rms, mean)
        for colour in range(3):
            for k in range(5):
                out[position] = t[colour, k] - tangential[f, colour, k]
                out[position + 1] = s[colour, k] - sagittal[f, colour, k]
                out[position + 2] = PHASE_WEIGHT * (re[colour, k] - in_phase[f, colour, k])
                position += 3
            out[position] = RADIUS_WEIGHT * (rms[colour] / wanted_rms[f, colour] - 1.0)
            out[position + 1] = LATERAL_WEIGHT * (mean[colour] - mean[1] - lateral[f, colour])
            position += 2
    out[position] = NOMINAL_WEIGHT * (unbounded * PIXEL / (3 * count * nominal) - 1.0)
    out[position + 1] = 0.02 * shadow
    position += 2

    centre, edge, most, air_centre, air_edge, length, back = limits
    total = 0.0
    for k in range(curvature.size):
        total += thickness[k]
        out[position] = max(abs(curvature[k]) * radii[k] - 0.85, 0.0) * 2.0 * MECHANICAL_WEIGHT
        if k < curvature.size - 1:
            glass = index[-1, k + 1] > 1.0
            height = max(radii[k], radii[k + 1])
            at_edge = thickness[k] + _sag(curvature[k + 1], height) - _sag(curvature[k], height)
            least, least_edge = (centre, edge) if glass else (air_centre, air_edge)
            out[position + 1] = max(least - thickness[k], 0.0) * MECHANICAL_WEIGHT
            out[position + 2] = max(least_edge - at_edge, 0.0) * MECHANICAL_WEIGHT
            out[position + 3] = max(thickness[k] - most, 0.0) * MECHANICAL_WEIGHT if glass else 0.0
            position += 4
        else:
            out[position + 1] = max(back - thickness[k], 0.0) * MECHANICAL_WEIGHT
            out[position + 2] = max(total / focal_length - length, 0.0) * MECHANICAL_WEIGHT
            position += 3
    for i in range(position):  # noqa: SIM110 - compiled
        if not abs(out[i]) < 1e6:
            return False
    return True


def residual_count(surfaces: int) -> int:
    """Return the number of residuals computed by `fill_residuals`."""
    return FIELDS.size * 51 + 2 + 4 * surfaces - 1


def damped_least_squares(free: Array, index: Array, stop: int, goal: Goal, iterations: int) -> tuple[Array, float]:
    """Run Levenberg-Marquardt with forward differences; return the parameters and the sum of squared residuals."""
    rows, columns = residual_count(index.shape[1] - 1), free.size
    base, trial, jacobian = np.zeros(rows), np.zeros(rows), np.zeros((columns, rows))
    best = free.copy()
    if not fill_residuals(best, index, stop, goal, LIMITS, base):
        return best, math.inf
    cost = _ordered_sum(base * base)
    damping = 1e-2
    for _ in range(iterations):
        for j in range(columns):
            moved = best.copy()
            moved[j] += STEP
            filled = fill_residuals(moved, index, stop, goal, LIMITS, trial)
            jacobian[j] = (trial - base) / STEP if filled else 0.0
        normal, gradient = _ordered_sum(jacobian[:, None] * jacobian), _ordered_sum(jacobian * base)
        for _ in range(6):
            moved = best - solve_damped(normal, gradient, damping)
            filled = fill_residuals(moved, index, stop, goal, LIMITS, trial)
            if filled and (new := _ordered_sum(trial * trial)) < cost:
                break
            damping *= 5.0
        else:
            break
        gain = 1.0 - new / cost
        best, cost, base, trial = moved, new, trial, base
        damping = max(damping * 0.2, 1e-9)
        if gain < 1e-4:
            break
    return best, float(cost)


def _ordered_sum(values: Array) -> Array:
    """Sum along the last axis, from first to last; the order of `np.sum` depends on the machine."""
    return np.asarray(np.cumsum(values, axis=-1)[..., -1])


@njit(cache=True, error_model="numpy")
def solve_damped(normal: Any, gradient: Any, damping: float) -> Any:
    """Solve (normal + damping diag(normal)) x = gradient by Cholesky decomposition, with operations in a fixed
    order.
    """
    size = gradient.size
    lower, x = np.zeros((size, size)), np.zeros(size)
    for a in range(size):
        for b in range(a + 1):
            value = normal[a, b] * (1.0 + damping if a == b else 1.0) + (1e-12 if a == b else 0.0)
            for k in range(b):
                value -= lower[a, k] * lower[b, k]
            if a == b:
                lower[a, a] = np.sqrt(max(value, 1e-12))
            else:
                lower[a, b] = value / lower[b, b]
    for a in range(size):
        value = gradient[a]
        for k in range(a):
            value -= lower[a, k] * x[k]
        x[a] = value / lower[a, a]
    for a in range(size - 1, -1, -1):
        value = x[a]
        for k in range(a + 1, size):
            value -= lower[k, a] * x[k]
        x[a] = value / lower[a, a]
    return x

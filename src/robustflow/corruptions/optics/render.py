"""Compute the PSFs of a lens over its field by ray tracing, and their statistics."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.errors import DataError
from .design import CHANNELS, channel_wavelengths
from .lens import PIXEL, Array, Lens
from .merit import AIM_TOLERANCE, WINDOW_RADIUS, aimed, landing
from .psf_field import FIELDS, SHAPE, SIZE, PsfField


@njit(cache=True, error_model="numpy")
def _bin(sx: Any, sy: Any, weight: Any, centre: float, out: Any) -> None:
    """Count the rays per pixel within a disk around (0, centre)."""
    half = out.shape[0] // 2
    for i in range(sx.size):
        v = sy[i] - centre
        if weight[i] > 0.0 and sx[i] * sx[i] + v * v <= WINDOW_RADIUS * WINDOW_RADIUS:
            row = int(np.floor(v + 0.5)) + half
            for u in (sx[i], -sx[i]):
                out[row, int(np.floor(u + 0.5)) + half] += 1.0


@njit(cache=True, error_model="numpy")
def _centroid(sx: Any, sy: Any, weight: Any) -> float:
    """Return the y centroid of the rays within a disk that is centred on that centroid."""
    centre = 0.0
    for step in range(60):
        total, moment = 0.0, 0.0
        for i in range(sx.size):
            v = sy[i] - centre
            if weight[i] > 0.0 and (step == 0 or sx[i] * sx[i] + v * v <= WINDOW_RADIUS * WINDOW_RADIUS):
                total += 1.0
                moment += sy[i]
        new = moment / total
        if step > 1 and abs(new - centre) < 1e-4:
            return new
        centre = new
    return centre


def field_rays(
    lens: Lens, fields: npt.NDArray[np.float64], columns: int = 96, rows: int = 192, samples: int = 5
) -> list[list[npt.NDArray[np.float64]]]:
    """Return the landing points of the rays for each field (outer list) and colour (inner list), float64 (3, R)."""
    tangents = fields * lens.field_tangent
    x, y, miss = aimed(lens, tangents)
    if not miss < AIM_TOLERANCE:
        raise DataError(lens.name, "for at least one field point, no ray reaches the edge of the stop")
    clear = lens.column("semi_diameter")
    clear[lens.stop] = np.inf
    count = fields.size
    result = []
    for f in range(count):
        pupil = y[2 * count + f], y[count + f], x[3 * count + f]
        colours = []
        for channel in CHANNELS:
            parts = []
            for wavelength in channel_wavelengths(channel, samples):
                surfaces, stop = lens.at(wavelength), (lens.stop, lens.stop_radius)
                sx, sy, weights, _ = landing(surfaces, clear, *stop, tangents[f], pupil, (columns, rows), 1e-9, 1.15)
                parts.append(np.stack([sx / PIXEL, sy / PIXEL, np.where(weights > 0.5, 1.0, 0.0)]))
            colours.append(np.concatenate(parts, axis=1))
        result.append(colours)
    return result


def render_psfs(lens: Lens) -> PsfField:
    """Compute the PSFs of a lens for 64 field points and 3 colours, with 18 000 rays per half pupil and wavelength."""
    stack = np.zeros(SHAPE)
    for f, field in enumerate(np.linspace(0.0, 1.0, FIELDS)):
        colours = field_rays(lens, np.array([field]))[0]
        centre = _centroid(*colours[1])
        for colour, (sx, sy, weight) in enumerate(colours):
            _bin(sx, sy, weight, centre, stack[f, colour])
    return PsfField(stack)


_PLACE = np.arange(SIZE) - SIZE // 2.0


class Moments(NamedTuple):
    """Statistics of each PSF in pixels, float64 (64, 3) each."""

    x: Array
    y: Array
    rms: Array


def moments(field: PsfField) -> Moments:
    """Return the centroids and RMS radii of a field's PSFs."""
    stack = field.stack.astype(np.float64)
    columns, rows = stack.sum(2), stack.sum(3)
    x, y = columns @ _PLACE, rows @ _PLACE
    second = columns @ _PLACE**2 + rows @ _PLACE**2
    return Moments(x, y, np.sqrt(second - x**2 - y**2))


def modulation(field: PsfField, frequencies: Array) -> tuple[Array, Array]:
    """Return the tangential and sagittal modulation transfer, (64, 3, frequencies) each."""
    waves = np.exp(-2j * np.pi * np.outer(_PLACE, frequencies))
    stack = field.stack.astype(np.float64)
    return np.abs(stack.sum(3) @ waves), np.abs(stack.sum(2) @ waves)


def nominal_rms(lens: Lens) -> float:
    """Return the mean RMS radius in mm over evenly spaced field points and the three colours, including all rays."""
    radii = []
    for place in np.linspace(0.0, 1.0, FIELDS):
        for x, y, weight in field_rays(lens, np.array([place]), 48, 96)[0]:
            mean = (weight * y).sum() / weight.sum()
            radii.append(np.sqrt((weight * (x * x + (y - mean) ** 2)).sum() / weight.sum()))
    return float(np.mean(radii) * PIXEL)

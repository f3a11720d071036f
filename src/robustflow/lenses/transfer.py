"""Statistics of rendered PSFs: modulation transfer, RMS radius and centroid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..psf.psf_field import FIELDS, SIZE, PsfField
from .prescription import PIXEL, Lens
from .render import field_rays

Array = npt.NDArray[np.float64]
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


def nominal_rms(lens: Lens, fields: int = FIELDS) -> float:
    """Return the mean RMS radius in mm over evenly spaced field points and the three colours, including all rays."""
    radii = []
    for place in np.linspace(0.0, 1.0, fields):
        for x, y, weight in field_rays(lens, np.array([place]), 48, 96)[0]:
            mean = (weight * y).sum() / weight.sum()
            radii.append(np.sqrt((weight * (x * x + (y - mean) ** 2)).sum() / weight.sum()))
    return float(np.mean(radii) * PIXEL)

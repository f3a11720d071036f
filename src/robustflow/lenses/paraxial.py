"""First-order properties of a lens: focal length, back focal distance and entrance pupil."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..compiled import njit
from .prescription import Lens

DESIGN_WAVELENGTH = 0.55
"""Reference wavelength for focal length and f-number, in micrometres."""


class FirstOrder(NamedTuple):
    """First-order properties of a lens; lengths are in mm."""

    focal_length: float
    back_focus: float
    pupil_position: float
    pupil_magnification: float


@njit(cache=True, error_model="numpy")
def first_order(curvature: Any, thickness: Any, index: Any, stop: int) -> tuple[float, float, float, float]:
    """Compute the fields of `FirstOrder` from curvatures (K,), thicknesses (K,) and refractive indices (K + 1,)."""
    height, slope = 1.0, 0.0
    surfaces = curvature.size
    for k in range(surfaces):
        slope = (index[k] * slope - height * curvature[k] * (index[k + 1] - index[k])) / index[k + 1]
        if k < surfaces - 1:
            height += thickness[k] * slope
    focal_length, back_focus = -1.0 / slope, -height / slope

    # Trace backwards from the centre of the stop (position) and from its edge, parallel to the axis (magnification).
    y, u, y_edge, u_edge = 0.0, 1.0, 1.0, 0.0
    for k in range(stop - 1, -1, -1):
        y -= thickness[k] * u
        y_edge -= thickness[k] * u_edge
        power = curvature[k] * (index[k + 1] - index[k])
        u = (index[k + 1] * u + y * power) / index[k]
        u_edge = (index[k + 1] * u_edge + y_edge * power) / index[k]
    # The image of the stop's centre lies where the ray (y, u) crosses the axis; its size follows from the edge ray.
    position = -y / u
    magnification = y_edge + u_edge * position
    return focal_length, back_focus, position, magnification


def first_order_of(lens: Lens, wavelength: float = DESIGN_WAVELENGTH) -> FirstOrder:
    """Return the first-order properties of a lens."""
    values = first_order(lens.column("curvature"), lens.column("thickness"), lens.indices(wavelength), lens.stop)
    return FirstOrder(*(float(value) for value in values))

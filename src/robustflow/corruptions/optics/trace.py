"""First-order properties of a lens: focal length, back focal distance and entrance pupil. Exact sequential ray
tracing through surfaces of revolution (spheres and conics), vectorised over rays.

The arithmetic uses only + - * / and sqrt, each rounded as IEEE 754 requires, in a fixed order and without contraction.
The results are therefore bit-identical on every machine, and rendered PSFs can be verified using hashes.

The intersection uses the closed form for conics (Welford, "Aberrations of Optical Systems", ch. 4): with the surface
written as c (x^2 + y^2 + (1 + k) z^2) = 2 z, the path length t from a point (x, y, z) along (l, m, n) is
t = C / (B + sqrt(B^2 - A C)), which also holds for planes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from .lens import Lens

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


Array = npt.NDArray[np.float64]


class Rays(NamedTuple):
    """R rays: positions in mm relative to the vertex of a surface and unit direction cosines, float64 (R,) each."""

    x: Array
    y: Array
    z: Array
    l: Array  # noqa: E741 - direction cosines are l, m, n
    m: Array
    n: Array
    alive: Array


@njit(cache=True, error_model="numpy")
def propagate(curvature: Any, conic: Any, thickness: Any, index: Any, clear: Any, rays: Any, path: Any) -> None:
    """Propagate rays, in place, from the vertex plane of the first surface in `curvature` (K,) through all of them."""
    x, y, z, l, m, n, alive = rays  # noqa: E741
    for k in range(curvature.size):
        c, shape, ratio, gap = curvature[k], 1.0 + conic[k], index[k] / index[k + 1], thickness[k]
        widest = clear[k] * clear[k]
        # Branch-free, so that the compiler can vectorise the loop.
        for i in range(x.size):
            x0, y0, z0, l0, m0, n0 = x[i], y[i], z[i], l[i], m[i], n[i]
            a = c * (1.0 + (shape - 1.0) * n0 * n0)
            b = n0 - c * (x0 * l0 + y0 * m0 + shape * z0 * n0)
            free = c * (x0 * x0 + y0 * y0 + shape * z0 * z0) - 2.0 * z0
            inside = b * b - a * free
            t = free / (b + np.sqrt(max(inside, 0.0)))
            px, py, pz = x0 + t * l0, y0 + t * m0, z0 + t * n0
            normal_z = 1.0 - c * shape * pz
            shorten = 1.0 / np.sqrt(c * c * (px * px + py * py) + normal_z * normal_z)
            nx, ny, nz = -c * px * shorten, -c * py * shorten, normal_z * shorten
            cosine = l0 * nx + m0 * ny + n0 * nz
            through = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
            bend = np.sqrt(max(through, 0.0)) - ratio * cosine
            meets = (inside >= 0.0) & (px * px + py * py <= widest) & (normal_z > 0.0)
            good = meets & (through >= 0.0) & (cosine > 0.0) & (alive[i] > 0.0)
            l[i] = ratio * l0 + bend * nx if good else l0
            m[i] = ratio * m0 + bend * ny if good else m0
            n[i] = ratio * n0 + bend * nz if good else n0
            x[i], y[i] = (px, py) if good else (x0, y0)
            z[i] = pz - gap if good else 0.0
            alive[i] = 1.0 if good else 0.0
        if path.shape[0] > 0:
            at = path[k]
            for i in range(x.size):  # assignments of whole arrays would take three seconds longer to compile
                at[0, i], at[1, i], at[2, i] = x[i], y[i], z[i] + gap


def trace(lens: Lens, rays: Rays, wavelength: float) -> tuple[Array, Rays]:
    """Trace rays from the vertex plane of the first surface to the sensor; rims and the stop block none of them."""
    carried, path = Rays(*(np.array(part, np.float64) for part in rays)), np.empty((len(lens.surfaces), 3, rays.x.size))
    propagate(
        lens.column("curvature"), lens.column("conic"), lens.column("thickness"), lens.indices(wavelength),
        np.full(len(lens.surfaces), np.inf), tuple(carried), path,
    )  # fmt: skip
    to_plane = -carried.z / np.where(carried.n > 0.0, carried.n, 1.0)
    x, y = carried.x + to_plane * carried.l, carried.y + to_plane * carried.m
    return path, carried._replace(x=x, y=y, z=np.zeros_like(x))

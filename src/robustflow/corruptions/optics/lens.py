"""Optical glasses, lens prescriptions, and exact sequential ray tracing.

The coefficients are from the Schott data sheets ("Optical Glass: Data Sheets"): dispersion constants B1..B3, and C1..C3
in micrometres squared, for the Sellmeier equation n(w)^2 - 1 = sum_i B_i w^2 / (w^2 - C_i), with the wavelength w in
micrometres. The indices n are relative to air.

The arithmetic of the tracer uses only + - * / and sqrt, each rounded as IEEE 754 requires, in a fixed order and without
contraction, so that rendered PSFs can be verified using hashes. The intersection uses the closed form for conics
(Welford, "Aberrations of Optical Systems", ch. 4): with the surface written as c (x^2 + y^2 + (1 + k) z^2) = 2 z, the
path length t from a point (x, y, z) along (l, m, n) is t = C / (B + sqrt(B^2 - A C)), which also holds for planes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError, field_validator, model_validator

from ...core.compiled import inner, njit
from ...core.errors import DataError, first_misfit, unknown_name
from ...core.files import write_bytes
from ...core.types import Frozen

AIR: Final = "air"

# Each comment gives the refractive index n_d (587.6 nm) and the Abbe number V_d.
SELLMEIER: Final[dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]] = {
    "N-FK51A": ((0.971247817, 0.216901417, 0.904651666), (0.00472301995, 0.0153575612, 168.68133)),  # 1.48656 84.5
    "N-PK52A": ((1.029607, 0.1880506, 0.736488165), (0.00516800155, 0.0166658798, 138.964129)),  # 1.49700 81.6
    "N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),  # 1.51680 64.2
    "N-K5": ((1.08511833, 0.199562005, 0.930511663), (0.00661099503, 0.024110866, 111.982777)),  # 1.52249 59.5
    "N-KF9": ((1.19286778, 0.0893346571, 0.920819805), (0.00839154696, 0.0404010786, 112.572446)),  # 1.52346 51.5
    "LLF1": ((1.21640125, 0.13366454, 0.883399468), (0.00857807248, 0.0420143003, 107.59306)),  # 1.54814 45.8
    "N-BAK4": ((1.28834642, 0.132817724, 0.945395373), (0.00779980626, 0.0315631177, 105.965875)),  # 1.56883 56.0
    "N-BALF4": ((1.31004128, 0.142038259, 0.964929351), (0.0079659645, 0.0330672072, 109.19732)),  # 1.57956 53.9
    "N-KZFS4": ((1.35055424, 0.197575506, 1.09962992), (0.0087628207, 0.0371767201, 90.3866994)),  # 1.61336 44.5
    "N-F2": ((1.39757037, 0.159201403, 1.2686543), (0.00995906143, 0.0546931752, 119.248346)),  # 1.62005 36.4
    "N-SK16": ((1.34317774, 0.241144399, 0.994317969), (0.00704687339, 0.0229005, 92.7508526)),  # 1.62041 60.3
    "N-SF2": ((1.47343127, 0.163681849, 1.36920899), (0.0109019098, 0.0585683687, 127.404933)),  # 1.64769 33.8
    "N-SSK5": ((1.59222659, 0.103520774, 1.05174016), (0.00920284626, 0.0423530072, 106.927374)),  # 1.65844 50.9
    "N-BAF10": ((1.5851495, 0.143559385, 1.08521269), (0.00926681282, 0.0424489805, 105.613573)),  # 1.67003 47.1
    "N-SF5": ((1.52481889, 0.187085527, 1.42729015), (0.011254756, 0.0588995392, 129.141675)),  # 1.67271 32.3
    "N-LAK9": ((1.46231905, 0.344399589, 1.15508372), (0.00724270156, 0.0243353131, 85.4686868)),  # 1.69100 54.7
    "N-LAK34": ((1.26661442, 0.665919318, 1.1249612), (0.00589278062, 0.0197509041, 78.8894174)),  # 1.72916 54.5
    "N-LAF2": ((1.80984227, 0.15729555, 1.0930037), (0.0101711622, 0.0442431765, 100.687748)),  # 1.74397 44.9
    "N-SF11": ((1.73759695, 0.313747346, 1.89878101), (0.013188707, 0.0623068142, 155.23629)),  # 1.78472 25.7
    "N-LASF44": ((1.78897105, 0.38675867, 1.30506243), (0.00872506277, 0.0308085023, 92.7743824)),  # 1.80420 46.5
    "N-SF6": ((1.77931763, 0.338149866, 2.08734474), (0.0133714182, 0.0617533621, 174.01759)),  # 1.80518 25.4
    "N-SF57": ((1.87543831, 0.37375749, 2.30001797), (0.0141749518, 0.0640509927, 177.389795)),  # 1.84666 23.8
    "N-LASF9": ((2.00029547, 0.298926886, 1.80691843), (0.0121426017, 0.0538736236, 156.530829)),  # 1.85025 32.2
    "N-SF66": ((2.0245976, 0.470187196, 2.59970433), (0.0147053225, 0.0692998276, 161.817601)),  # 1.92286 20.9
}


def refractive_index(glass: str, wavelength: float) -> float:
    """Return the refractive index of a catalogue glass relative to air (1 for "air")."""
    if glass == AIR:
        return 1.0
    if glass not in SELLMEIER:
        raise unknown_name("glass", glass, SELLMEIER)
    squared = wavelength * wavelength
    (b1, b2, b3), (c1, c2, c3) = SELLMEIER[glass]
    return math.sqrt(
        1.0 + b1 * squared / (squared - c1) + b2 * squared / (squared - c2) + b3 * squared / (squared - c3)
    )


def abbe_number(glass: str) -> float:
    """Return the Abbe number V_d = (n_d - 1) / (n_F - n_C), the inverse dispersion."""
    n_d, n_f, n_c = (refractive_index(glass, w) for w in (0.5875618, 0.4861327, 0.6562725))
    return (n_d - 1.0) / (n_f - n_c)


IMAGE_RADIUS = 14.3
"""Half diagonal of the sensor in mm: 1154 pixels of 12.394 um, the distance from centre to corner at 1920 x 1280."""

PIXEL = 0.012394
"""Size of an effective pixel in mm."""

Array = npt.NDArray[np.float64]


class Surfaces(NamedTuple):
    """The surfaces of a lens at one wavelength."""

    curvature: Array  # (K,) in 1/mm
    conic: Array  # (K,)
    thickness: Array  # (K,) distance to the next surface, in mm
    indices: Array  # (K + 1,) refractive indices in front of the first surface and behind each surface


_Finite = Annotated[float, Field(allow_inf_nan=False)]


def tangent_of(degrees: float) -> float:
    """Return the tangent of an angle, rounded to twelve digits.

    >>> tangent_of(45.0)
    1.0
    """
    return round(math.tan(math.radians(degrees)), 12)


class Surface(Frozen):
    """A surface of revolution, z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2))."""

    curvature: _Finite
    conic: _Finite = 0.0
    thickness: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    glass: str = AIR
    semi_diameter: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]

    @field_validator("glass")
    @classmethod
    def _known_glass(cls, glass: str) -> str:
        if glass != AIR and glass not in SELLMEIER:
            raise ValueError(f"glass '{glass}' is not in the catalogue: {', '.join(SELLMEIER)}")
        return glass


class Lens(Frozen):
    """A lens focused at infinity."""

    name: str
    surfaces: tuple[Surface, ...] = Field(min_length=2, max_length=100)
    stop: int
    f_number: Annotated[float, Field(gt=0.0, le=100.0)]
    half_field: Annotated[float, Field(gt=0.0, lt=80.0)]

    @model_validator(mode="after")
    def _stop_is_a_plane_in_air(self) -> Lens:
        if not 0 <= self.stop < len(self.surfaces):
            raise ValueError(f"stop {self.stop} is not one of the {len(self.surfaces)} surfaces")
        before = self.surfaces[self.stop - 1].glass if self.stop else AIR
        stop = self.surfaces[self.stop]
        if stop.curvature != 0.0 or stop.glass != AIR or before != AIR:
            raise ValueError(f"surface {self.stop}, the stop, must be a plane in air")
        if self.surfaces[-1].glass != AIR:
            raise ValueError("the medium behind the last surface must be air")
        return self

    @property
    def elements(self) -> int:
        return sum(surface.glass != AIR for surface in self.surfaces)

    @property
    def stop_radius(self) -> float:
        """Radius of the aperture stop in mm."""
        return self.surfaces[self.stop].semi_diameter

    @property
    def field_tangent(self) -> float:
        return tangent_of(self.half_field)

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Return one attribute of all surfaces, float64 (K,), such as `lens.column("curvature")`."""
        return np.array([getattr(surface, name) for surface in self.surfaces], np.float64)

    def at(self, wavelength: float) -> Surfaces:
        """Return the surfaces with the refractive indices at a wavelength in um."""
        media = [AIR, *(surface.glass for surface in self.surfaces)]
        index = np.array([refractive_index(glass, wavelength) for glass in media], np.float64)
        return Surfaces(self.column("curvature"), self.column("conic"), self.column("thickness"), index)


def read_lens(path: str | Path) -> Lens:
    path = Path(path)
    try:
        return Lens.model_validate_json(path.read_bytes())
    except OSError as error:
        raise DataError(path, f"this lens prescription cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        raise DataError(path, f"not a lens prescription: {first_misfit(error)}") from error


def write_lens(lens: Lens, path: str | Path) -> None:
    """Write a prescription as JSON; `read_lens` reads it back without loss."""
    write_bytes(Path(path), (lens.model_dump_json(indent=1) + "\n").encode())


DESIGN_WAVELENGTH = 0.55
"""Reference wavelength for focal length and f-number, in micrometres."""


class FirstOrder(NamedTuple):
    """First-order properties of a lens; lengths are in mm."""

    focal_length: float
    back_focus: float
    pupil_position: float
    pupil_magnification: float


@njit(cache=True, error_model="numpy")
def first_order(surfaces: Any, stop: int) -> FirstOrder:
    """Trace paraxial rays through `surfaces`: curvature, conic, thickness, index, one array each."""
    curvature, _, thickness, index = surfaces
    height, slope = 1.0, 0.0
    for k in range(curvature.size):
        slope = (index[k] * slope - height * curvature[k] * (index[k + 1] - index[k])) / index[k + 1]
        if k < curvature.size - 1:
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
    return FirstOrder(focal_length, back_focus, position, magnification)


def first_order_of(lens: Lens, wavelength: float = DESIGN_WAVELENGTH) -> FirstOrder:
    order: FirstOrder = first_order(lens.at(wavelength), lens.stop)
    return order


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
def launched(x: Any, y: Any, tangent: Any) -> Rays:
    """Return rays that start at x and y (R,) in the vertex plane of the first surface, with one field tangent per
    ray.
    """
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    return Rays(x.copy(), y.copy(), np.zeros(x.size), np.zeros(x.size), tangent * cosine, cosine, np.ones(x.size))


@inner
def plane_points(rays: Any) -> Any:
    """Return x and y of the points where rays cross the plane z = 0."""
    t = -rays.z / rays.n
    return rays.x + t * rays.l, rays.y + t * rays.m


@njit(cache=True, error_model="numpy")
def propagate(surfaces: Any, first: int, last: int, clear: Any, rays: Any, path: Any) -> None:
    """Propagate rays, in place, from the vertex plane of surface `first` to that behind surface `last` - 1; surface k
    blocks rays beyond `clear[k]`, and `path[k]` receives their points on it, unless `path` is empty.
    """
    curvature, conic, thickness, index = surfaces
    x, y, z, l, m, n, alive = rays  # noqa: E741
    for k in range(first, last):
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
    count = len(lens.surfaces)
    carried, path = Rays(*(part.copy() for part in rays)), np.empty((count, 3, rays.x.size))
    propagate(lens.at(wavelength), 0, count, np.full(count, np.inf), carried, path)
    x, y = plane_points(carried)
    return path, carried._replace(x=x, y=y, z=np.zeros_like(x))

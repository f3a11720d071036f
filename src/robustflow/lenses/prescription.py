"""A lens prescription: a validated list of surfaces from the object to the sensor, stored as JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError, field_validator, model_validator

from ..atomic import write_bytes
from ..errors import DataError, first_misfit
from ..validated import Frozen
from .glass import AIR, SELLMEIER, refractive_index

IMAGE_RADIUS = 14.3
"""Half diagonal of the sensor in mm: 1154 pixels of 12.394 um, the distance from centre to corner at 1920 x 1280."""

PIXEL = 0.012394
"""Size of an effective pixel in mm."""

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
        """Number of glass elements."""
        return sum(surface.glass != AIR for surface in self.surfaces)

    @property
    def stop_radius(self) -> float:
        """Radius of the aperture stop in mm."""
        return self.surfaces[self.stop].semi_diameter

    @property
    def field_tangent(self) -> float:
        """Tangent of the half field angle."""
        return tangent_of(self.half_field)

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Return one attribute of all surfaces, float64 (K,), such as `lens.column("curvature")`."""
        return np.array([getattr(surface, name) for surface in self.surfaces], np.float64)

    def indices(self, wavelength: float) -> npt.NDArray[np.float64]:
        """Return the refractive indices in front of the first surface and behind each surface, (K + 1,), at a
        wavelength in um.
        """
        media = [AIR, *(surface.glass for surface in self.surfaces)]
        return np.array([refractive_index(glass, wavelength) for glass in media], np.float64)


def read_lens(path: str | Path) -> Lens:
    """Read a prescription."""
    path = Path(path)
    try:
        return Lens.model_validate_json(path.read_bytes())
    except OSError as error:
        raise DataError(f"cannot read lens prescription {path}: {error.strerror or error}") from error
    except ValidationError as error:
        raise DataError(f"{path} is not a lens prescription: {first_misfit(error)}") from error


def write_lens(lens: Lens, path: str | Path) -> None:
    """Write a prescription as JSON; `read_lens` reads it back without loss."""
    write_bytes(Path(path), (lens.model_dump_json(indent=1) + "\n").encode())

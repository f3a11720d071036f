"""Design goals for the lens of each severity: the paper's values and the measured blur of the reference lens.

The paper specifies the RMS radius of five lenses; the reference code specifies the number of elements, the half field
and the f-number. `data/goals.json` contains measurements of the PSFs released with that code, per severity and colour:
modulation transfer and its in-phase part at five frequencies, RMS radius and lateral colour, all at six field points.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources

import numpy as np

from ..severity import check_severity
from .merit import Goal
from .prescription import IMAGE_RADIUS, tangent_of


@dataclass(frozen=True)
class Specification:
    """Specification of a lens: number of elements, number of elements in front of the stop, half field in degrees,
    f-number, nominal RMS radius in mm.
    """

    elements: int
    stop: int
    half_field: float
    f_number: float
    rms: float


SPECIFICATIONS = (
    Specification(6, 0, 20.0, 2.6, 0.0296),
    Specification(1, 0, 34.0, 3.8, 0.0832),
    Specification(6, 6, 28.0, 2.0, 0.1102),
    Specification(3, 2, 22.0, 2.0, 0.1588),
    Specification(4, 4, 20.0, 2.0, 0.1939),
)
"""Specifications for severities 1 to 5 (RMS radii from the paper, appendix, PSF blur)."""


def goal_of(severity: int) -> tuple[Specification, Goal]:
    """Return the specification and the goal for the lens of a severity."""
    specification = SPECIFICATIONS[check_severity(severity) - 1]
    text = resources.files(__package__).joinpath("data", "goals.json").read_text(encoding="utf-8")
    measured = json.loads(text)[str(severity)]
    tangent = tangent_of(specification.half_field)
    return specification, Goal(
        focal_length=IMAGE_RADIUS / tangent,
        f_number=specification.f_number,
        field_tangent=tangent,
        tangential=np.array(measured["tangential"], np.float64),
        in_phase=np.array(measured["in_phase"], np.float64),
        sagittal=np.array(measured["sagittal"], np.float64),
        rms=np.array(measured["rms"], np.float64),
        lateral=np.array(measured["lateral"], np.float64),
        nominal_rms=specification.rms,
    )

"""Design goals for the lens of each severity: the paper's values and the measured blur of the reference lens. Load
and verify the prescriptions of the five lenses in the package, and write new lenses to the package. Design the
lens for a severity: search for a lens and convert the result to a prescription.

The paper specifies the RMS radius of five lenses; the reference code specifies the number of elements, the half field
and the f-number. `data/goals.json` contains measurements of the PSFs released with that code, per severity and colour:
modulation transfer and its in-phase part at five frequencies, RMS radius and lateral colour, all at six field points.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from ...core.arguments import check_severity
from ...core.files import write_bytes, write_json
from ...core.rng import Rng
from . import psf_field as shipped_psfs
from .lens import AIR, IMAGE_RADIUS, Lens, Surface, read_lens, tangent_of, write_lens
from .merit import FIELDS, Goal, aim
from .psf_field import PsfField, check_digest, half_digest, halved
from .residuals import build_lens, clear_radii
from .search import SAMPLES, Budget, Candidate, search


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


def shipped_lens(severity: int) -> Lens:
    """Return the prescription of the shipped lens for a severity."""
    lens = read_lens(shipped_psfs.DATA / f"lens_s{check_severity(severity)}.json")
    check_digest(f"lens_s{severity}", lens_digest(lens))
    return lens


def lens_digest(lens: Lens) -> str:
    """Return the SHA-256 of a prescription, regardless of the line endings in the file."""
    return hashlib.sha256(lens.model_dump_json().encode()).hexdigest()


def ship_lens(severity: int, lens: Lens, field: PsfField, folder: Path | None = None) -> None:
    """Write a lens, its PSFs and their hashes to the package's data folder."""
    folder = shipped_psfs.DATA if folder is None else folder
    half = halved(field)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, half=half.astype("<f2"))
    write_lens(lens, folder / f"lens_s{severity}.json")
    write_bytes(folder / f"psf_s{severity}.npz", buffer.getvalue())
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_json(path, {**manifest, f"lens_s{severity}": lens_digest(lens), f"psf_s{severity}": half_digest(half)})


SHIPPED_SEEDS = (0, 0, 0, 0, 0)
"""Seeds with which the search found the shipped lenses for severities 1 to 5."""


def design(
    severity: int, seed: int, budget: Budget | None = None, report: Callable[[str], None] = lambda line: None
) -> Lens:
    """Search for the lens for a severity; the same seed always results in the same lens on every machine."""
    specification, goal = goal_of(severity)
    rng = Rng.of("robustflow.optics", severity, seed)
    best = search(specification.elements, specification.stop, goal, rng, budget or Budget(), report)
    return prescription_of(best, goal, specification.half_field, f"severity {severity}, seed {seed}")


def prescription_of(candidate: Candidate, goal: Goal, half_field: float, name: str) -> Lens:
    """Convert a candidate to a prescription, rounded to drawing precision (1e-8 1/mm, 1e-6 mm)."""
    structure = candidate.structure
    index, stop = structure.indices(SAMPLES), structure.stop_surface
    curvature, thickness, radius, pupil, magnification = build_lens(
        candidate.free, index, stop, goal.focal_length, goal.f_number
    )
    conic, tangents = np.zeros(curvature.size), FIELDS * goal.field_tangent
    x, y, _ = aim(curvature, conic, thickness, index[-1], stop, radius, tangents, pupil, magnification)
    radii, _ = clear_radii(curvature, conic, thickness, index[-1], x, y, np.tile(tangents, 4))
    surfaces = []
    for k in range(curvature.size):
        clear = radius if k == stop else radii[k]
        surfaces.append(
            Surface(
                curvature=round(float(curvature[k]), 8),
                thickness=round(max(float(thickness[k]), 0.0), 6),
                glass=structure.media[k + 1],
                semi_diameter=round(float(clear), 6),
            )
        )
    return Lens(
        name=name,
        surfaces=tuple(surfaces),
        stop=stop,
        f_number=goal.f_number,
        half_field=half_field,
    )


def structure_line(lens: Lens) -> str:
    """Return the glasses of the elements in order, with a vertical bar at the position of the stop.

    >>> from robustflow.corruptions.optics.design import shipped_lens
    >>> structure_line(shipped_lens(2)).startswith("| ")
    True
    """
    parts = ["|" if k == lens.stop else surface.glass for k, surface in enumerate(lens.surfaces)]
    return " ".join(part for part in parts if part != AIR)

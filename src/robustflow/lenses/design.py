"""Design the lens for a severity: search for a lens and convert the result to a prescription."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..random.rng import Rng
from .glass import AIR
from .goals import goal_of
from .merit import FIELDS, Goal, aim
from .prescription import Lens, Surface
from .residuals import build_lens, clear_radii
from .search import SAMPLES, Budget, Candidate, search

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

    >>> from robustflow.lenses.shipped import shipped_lens
    >>> structure_line(shipped_lens(2)).startswith("| ")
    True
    """
    parts = ["|" if k == lens.stop else surface.glass for k, surface in enumerate(lens.surfaces)]
    return " ".join(part for part in parts if part != AIR)

"""Search for the lens of a severity whose blur is that of the reference lens.

The paper specifies the RMS radius of five lenses; the reference code specifies the number of elements, the half field
and the f-number. `data/goals.json` contains measurements of the PSFs released with that code, per severity and colour:
modulation transfer and its in-phase part at five frequencies, RMS radius and lateral colour, all at six field points.

The search: random structures, screening, damped least squares, and global moves. Every random choice uses a named
random stream, and every stage has a fixed number of steps instead of a time limit, so the result depends only on the
severity and the seed. Gao et al. (2024) and the paper call this a global search for minimalist lenses.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from ...core.arguments import check_severity
from ...core.errors import RobustFlowError, unknown_name
from ...core.files import write_bytes, write_json
from ...core.rng import Rng
from ..optics import psf_field as shipped_psfs
from .lens import (
    AIR,
    DESIGN_WAVELENGTH,
    IMAGE_RADIUS,
    SELLMEIER,
    Array,
    FirstOrder,
    Lens,
    Surface,
    Surfaces,
    abbe_number,
    read_lens,
    refractive_index,
    tangent_of,
    write_lens,
)
from .merit import AIM_TOLERANCE, FIELDS, LIMITS, Goal, aim
from .psf_field import PsfField, check_digest, half_digest, halved
from .residuals import build_lens, clear_radii, damped_least_squares, fill_residuals, residual_count

CHANNELS: dict[str, float] = {"red": 0.64, "green": 0.54, "blue": 0.46}
"""Centre of each channel's band in micrometres, in the order R, G, B."""

BANDWIDTH = 0.1
"""Width of each band in micrometres."""


def channel_wavelengths(channel: str, samples: int = 5) -> tuple[float, ...]:
    """Return equally spaced wavelengths within a channel, in micrometres.

    >>> channel_wavelengths("green")
    (0.5, 0.52, 0.54, 0.56, 0.58)
    """
    if channel not in CHANNELS:
        raise unknown_name("channel", channel, CHANNELS)
    step = BANDWIDTH / samples
    return tuple(round(CHANNELS[channel] + (k - (samples - 1) / 2) * step, 6) for k in range(samples))


_GLASSES = tuple(SELLMEIER)


@dataclass(frozen=True)
class Structure:
    """Discrete parameters of a lens: the glasses in order and the position of the stop."""

    glasses: tuple[str, ...]
    stop: int

    @property
    def media(self) -> tuple[str, ...]:
        """Medium in front of the lens and behind each surface, including the stop; (K + 1,)."""
        media = [AIR]
        for element, glass in enumerate((*self.glasses, AIR)):
            if element == self.stop:
                media.append(AIR)
            if element < len(self.glasses):
                media += [glass, AIR]
        return tuple(media)

    @property
    def stop_surface(self) -> int:
        """Index of the stop among the surfaces."""
        return 2 * self.stop

    def indices(self, samples: int) -> Array:
        """Return the refractive indices at the wavelengths of the channels, followed by the design wavelength."""
        wavelengths = [w for channel in CHANNELS for w in channel_wavelengths(channel, samples)]
        return np.array(
            [[refractive_index(glass, w) for glass in self.media] for w in (*wavelengths, DESIGN_WAVELENGTH)]
        )


@dataclass(frozen=True)
class Candidate:
    """A structure, its free parameters (see `residuals`) and its sum of squared residuals."""

    structure: Structure
    free: Array
    cost: float


@dataclass(frozen=True)
class Budget:
    """Number of steps in each stage of the search."""

    structures: int = 1500
    screened: int = 24
    pool: int = 8
    moves: int = 150
    first_iterations: int = 10
    iterations: int = 14
    last_iterations: int = 60


SAMPLES = 3
"""Number of wavelengths per channel during the search; rendering uses five."""


def _cost(structure: Structure, free: Array, goal: Goal) -> float:
    index = structure.indices(SAMPLES)
    out = np.zeros(residual_count(index.shape[1] - 1))
    if not fill_residuals(free, index, structure.stop_surface, goal, LIMITS, out):
        return float("inf")
    return float((out * out).sum())


def refine(candidate: Candidate, goal: Goal, iterations: int) -> Candidate:
    """Refine a candidate by damped least squares; the parameters are rounded to 1e-9."""
    structure = candidate.structure
    index = structure.indices(SAMPLES)
    free, cost = damped_least_squares(candidate.free, index, structure.stop_surface, goal, iterations)
    return Candidate(structure, np.round(free, 9), float(cost))


def random_candidate(rng: Rng, elements: int, stop: int) -> Candidate:
    """Draw a random candidate: glasses, powers (which add up to that of the lens), bendings, thicknesses and gaps."""
    structure = Structure(tuple(_GLASSES[rng.integer(0, len(_GLASSES))] for _ in range(elements)), stop)
    powers = np.array([rng.uniform(-2.0, 2.5) for _ in range(elements)]) if elements > 1 else np.ones(1)
    powers += (1.0 - powers.sum()) / elements
    curvatures: list[float] = []
    for power, glass in zip(powers, structure.glasses, strict=True):
        bending = rng.uniform(-2.5, 2.5)
        strength = power / (2.0 * (refractive_index(glass, DESIGN_WAVELENGTH) - 1.0))
        curvatures += [strength * (bending + 1.0), strength * (bending - 1.0)]
    media = structure.media
    gaps = [rng.uniform(0.06, 0.2) if glass != AIR else rng.uniform(0.01, 0.25) for glass in media[1:-1]]
    return Candidate(structure, np.array([*curvatures, *gaps, rng.uniform(-1.0, 0.5)]), float("inf"))


def move(candidate: Candidate, rng: Rng) -> Candidate:
    """Make one global move: bend an element, shift power between two elements, swap a glass, change the gaps, or
    perturb all parameters.
    """
    structure, free = candidate.structure, candidate.free.copy()
    elements = len(structure.glasses)
    curved = 2 * elements
    kind, element = rng.integer(0, 5), rng.integer(0, elements)
    first, second = 2 * element, 2 * element + 1
    if kind == 0:
        shift = rng.uniform(-1.0, 1.0)
        free[first] += shift
        free[second] += shift
    elif kind == 1:
        other = 2 * rng.integer(0, elements)
        amount = rng.uniform(-0.6, 0.6)
        free[first] += amount
        free[other] -= amount
    elif kind == 2:
        old = structure.glasses[element]
        glass = _GLASSES[rng.integer(0, len(_GLASSES))]
        if rng.uniform() < 0.5:
            near = sorted(_GLASSES, key=lambda g: _glass_distance(old, g))[1:7]
            glass = near[rng.integer(0, len(near))]
        glasses = (*structure.glasses[:element], glass, *structure.glasses[element + 1 :])
        ratio = (refractive_index(old, DESIGN_WAVELENGTH) - 1) / (refractive_index(glass, DESIGN_WAVELENGTH) - 1)
        free[first : second + 1] *= ratio
        structure = replace(structure, glasses=glasses)
    elif kind == 3:
        free[curved:-1] *= 1.0 + 0.8 * (rng.uniforms(free.size - 1 - curved) - 0.4)
        free[-1] += rng.uniform(-1.0, 1.0)
    else:
        free[:curved] += 0.3 * (rng.uniforms(curved) - 0.5)
    return Candidate(structure, free, float("inf"))


def _glass_distance(first: str, second: str) -> float:
    index = refractive_index(first, DESIGN_WAVELENGTH) - refractive_index(second, DESIGN_WAVELENGTH)
    return abs(index) * 100.0 + abs(abbe_number(first) - abbe_number(second))


def search(
    elements: int, stop: int, goal: Goal, rng: Rng, budget: Budget, report: Callable[[str], None] = lambda line: None
) -> Candidate:
    """Return the best lens found within a budget."""
    drawn: list[Candidate] = []
    for number in range(budget.structures):
        candidate = random_candidate(rng.spawn("structure", number), elements, stop)
        cost = _cost(candidate.structure, candidate.free, goal)
        if np.isfinite(cost):
            drawn.append(replace(candidate, cost=cost))
    drawn.sort(key=lambda candidate: candidate.cost)
    screened = [refine(c, goal, budget.first_iterations) for c in drawn[: budget.screened]]
    pool = sorted(screened, key=lambda candidate: candidate.cost)[: budget.pool]
    report(f"{len(drawn)} of {budget.structures} structures can be traced; best after screening: {pool[0].cost:.4f}")
    for number in range(budget.moves):
        choices = rng.spawn("move", number)
        share = choices.uniform()
        place = int(share * share * len(pool))  # better candidates are chosen more often
        tried = refine(move(pool[place], choices), goal, budget.iterations)
        if tried.cost < pool[place].cost:
            pool[place] = tried
            pool.sort(key=lambda candidate: candidate.cost)
        if number % 25 == 24:
            report(f"move {number + 1}: " + " ".join(f"{candidate.cost:.4f}" for candidate in pool))
    for candidate in pool:
        best = refine(candidate, goal, budget.last_iterations)
        if _fills_its_stop(best, goal):
            return best
    raise RobustFlowError("the search found no lens whose stop is filled from every field point; try a different seed")


def _fills_its_stop(candidate: Candidate, goal: Goal) -> bool:
    """Return whether rays from 64 field points, not only the six of the merit function, reach the edge of the stop."""
    surfaces, radius, order = _built(candidate, goal)
    tangents = np.linspace(0.0, 1.0, 64) * goal.field_tangent
    _, _, miss = aim(surfaces, candidate.structure.stop_surface, radius, tangents, order)
    return bool(miss < AIM_TOLERANCE)


def _built(candidate: Candidate, goal: Goal) -> tuple[Surfaces, float, FirstOrder]:
    """Return the surfaces at the design wavelength, the radius of the stop and the first-order properties."""
    structure = candidate.structure
    built: tuple[Surfaces, float, FirstOrder] = build_lens(
        candidate.free, structure.indices(SAMPLES), structure.stop_surface, goal.focal_length, goal.f_number
    )
    return built


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
        **{name: np.array(values, np.float64) for name, values in measured.items()},
        nominal_rms=specification.rms,
    )


def shipped_lens(severity: int) -> Lens:
    lens = read_lens(shipped_psfs.DATA / f"lens_s{check_severity(severity)}.json")
    check_digest(f"lens_s{severity}", lens_digest(lens))
    return lens


def lens_digest(lens: Lens) -> str:
    """Return the SHA-256 of a prescription, regardless of the line endings in the file."""
    return hashlib.sha256(lens.model_dump_json().encode()).hexdigest()


def ship_lens(severity: int, lens: Lens, field: PsfField) -> None:
    """Write a lens, its PSFs and their hashes to the package's data folder."""
    folder = shipped_psfs.DATA
    half = halved(field)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, half=half.astype("<f2"))
    write_lens(lens, folder / f"lens_s{severity}.json")
    write_bytes(folder / f"psf_s{severity}.npz", buffer.getvalue())
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_json(path, {**manifest, f"lens_s{severity}": lens_digest(lens), f"psf_s{severity}": half_digest(half)})


def design(
    severity: int, seed: int = 0, budget: Budget | None = None, report: Callable[[str], None] = lambda line: None
) -> Lens:
    """Search for the lens for a severity; the same seed always results in the same lens on every machine.

    The shipped lenses have seed 0.
    """
    specification, goal = goal_of(severity)
    rng = Rng.of("robustflow.optics", severity, seed)
    best = search(specification.elements, specification.stop, goal, rng, budget or Budget(), report)
    return prescription_of(best, goal, specification.half_field, f"severity {severity}, seed {seed}")


def prescription_of(candidate: Candidate, goal: Goal, half_field: float, name: str) -> Lens:
    """Convert a candidate to a prescription, rounded to drawing precision (1e-8 1/mm, 1e-6 mm)."""
    stop, tangents = candidate.structure.stop_surface, FIELDS * goal.field_tangent
    built, radius, order = _built(candidate, goal)
    x, y, _ = aim(built, stop, radius, tangents, order)
    radii, _ = clear_radii(built, x, y, np.tile(tangents, 4))
    radii[stop] = radius
    surfaces = tuple(
        Surface(
            curvature=round(curvature, 8),
            thickness=round(max(thickness, 0.0), 6),
            glass=glass,
            semi_diameter=round(clear, 6),
        )
        for curvature, thickness, glass, clear in zip(
            built.curvature.tolist(),
            built.thickness.tolist(),
            candidate.structure.media[1:],
            radii.tolist(),
            strict=True,
        )
    )
    return Lens(name=name, surfaces=surfaces, stop=stop, f_number=goal.f_number, half_field=half_field)


def structure_line(lens: Lens) -> str:
    """Return the glasses of the elements in order, with a vertical bar at the position of the stop.

    >>> from robustflow.corruptions.optics.design import shipped_lens
    >>> structure_line(shipped_lens(2)).startswith("| ")
    True
    """
    parts = ["|" if k == lens.stop else surface.glass for k, surface in enumerate(lens.surfaces)]
    return " ".join(part for part in parts if part != AIR)

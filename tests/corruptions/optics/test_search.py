"""The search depends only on its seed, ends after a fixed number of steps, and improves in every stage."""

import numpy as np
import pytest

from robustflow.core.errors import UsageError
from robustflow.core.rng import Rng
from robustflow.corruptions.optics.design import (
    SHIPPED_SEEDS,
    SPECIFICATIONS,
    Budget,
    Candidate,
    Structure,
    design,
    goal_of,
    lens_digest,
    move,
    prescription_of,
    random_candidate,
    refine,
    search,
)
from robustflow.corruptions.optics.lens import DESIGN_WAVELENGTH, first_order_of, refractive_index
from robustflow.corruptions.optics.psf_field import manifest

SMALL = Budget(structures=40, screened=4, pool=3, moves=6, first_iterations=4, iterations=4, last_iterations=6)


def test_media_and_stop_of_a_structure():
    structure = Structure(("N-BK7", "N-SF6"), 1)
    assert structure.media == ("air", "N-BK7", "air", "air", "N-SF6", "air")
    assert structure.stop_surface == 2
    assert Structure(("N-BK7",), 1).media == ("air", "N-BK7", "air", "air")
    assert Structure(("N-BK7",), 0).media == ("air", "air", "N-BK7", "air")


def test_random_structures_have_the_power_requested():
    """For thin lenses in contact, the powers (n - 1) (c1 - c2) add up to the power of the lens, 1 / focal length."""
    for number in range(20):
        candidate = random_candidate(Rng.of("test", number), 3, 1)
        faces = candidate.free[:6].reshape(3, 2)
        glasses = candidate.structure.glasses
        powers = [
            (refractive_index(glass, DESIGN_WAVELENGTH) - 1) * (front - back)
            for glass, (front, back) in zip(glasses, faces, strict=True)
        ]
        assert sum(powers) == pytest.approx(1.0, abs=1e-9)


def test_different_seed_finds_a_different_lens_that_meets_the_specification():
    specification, (_, goal) = SPECIFICATIONS[1], goal_of(2)
    lines = []
    first, second = design(2, 5, SMALL, lines.append), design(2, 6, SMALL)
    assert first.surfaces != second.surfaces
    assert lines[0].endswith(tuple("0123456789"))
    for lens in (first, second):
        assert lens.elements == specification.elements
        assert first_order_of(lens).focal_length == pytest.approx(goal.focal_length, rel=1e-6)
        assert lens.stop == 0


def test_moves_never_raise_the_cost():
    specification, goal = goal_of(4)
    few = search(specification.elements, specification.stop, goal, Rng.of("m"), Budget(200, 4, 3, 0, 4, 4, 6))
    more = search(specification.elements, specification.stop, goal, Rng.of("m"), Budget(200, 4, 3, 12, 4, 4, 6))
    assert more.cost <= few.cost * 1.02


def test_every_kind_of_move_keeps_the_structure_sound():
    candidate = random_candidate(Rng.of("moves"), 4, 2)
    kinds = set()
    for number in range(60):
        moved = move(candidate, Rng.of("move", number))
        assert moved.free.size == candidate.free.size
        assert np.isfinite(moved.free).all()
        assert moved.structure.stop == 2
        kinds.add((moved.structure != candidate.structure, tuple(np.flatnonzero(moved.free != candidate.free))))
    assert len(kinds) >= 5
    assert any(changed for changed, _ in kinds)


def test_refining_never_raises_the_cost():
    specification, goal = goal_of(2)
    start = Candidate(Structure(("N-K5",), 0), np.array([-0.2, -0.9, 0.2, 0.3, -1.0]), np.inf)
    refined = refine(start, goal, 3)
    refined_again = refine(refined, goal, 10)
    assert refined_again.cost <= refined.cost * (1 + 1e-6)
    assert prescription_of(refined_again, goal, specification.half_field, "x").elements == specification.elements


def test_a_severity_of_six_is_refused():
    with pytest.raises(UsageError, match="severity 6 does not exist"):
        design(6, 0, SMALL)


def test_the_singlet_is_found_again_from_its_seed():
    assert lens_digest(design(2, SHIPPED_SEEDS[1])) == manifest()["lens_s2"]


@pytest.mark.slow
@pytest.mark.parametrize("severity", [1, 3, 4, 5])
def test_each_shipped_lens_is_found_again_from_its_seed(severity):
    assert lens_digest(design(severity, SHIPPED_SEEDS[severity - 1])) == manifest()[f"lens_s{severity}"]

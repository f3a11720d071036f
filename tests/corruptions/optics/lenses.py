"""Textbook lenses and rays used in tests."""

import math

import numpy as np

from robustflow.corruptions.optics.lens import AIR, Lens, Rays, Surface, launched, refractive_index


def bundle(heights, tangent=0.0, across=0.0) -> Rays:
    """Return rays at the given heights in mm, which are inclined in the meridional plane."""
    y = np.atleast_1d(np.asarray(heights, float))
    return launched(np.full_like(y, across), y, np.full_like(y, tangent))


def lens_of(rows: list[tuple[float, float, str, float]], stop: int, conics: dict[int, float] | None = None) -> Lens:
    """Return a lens from rows of (radius of curvature or 0 for a plane, thickness, glass behind, semi-diameter)."""
    surfaces = tuple(
        Surface(
            curvature=1.0 / radius if radius else 0.0,
            thickness=thickness,
            glass=glass,
            semi_diameter=clear,
            conic=(conics or {}).get(k, 0.0),
        )
        for k, (radius, thickness, glass, clear) in enumerate(rows)
    )
    return Lens(name="test", surfaces=surfaces, stop=stop, f_number=5.0, half_field=15.0)


def cooke_triplet() -> Lens:
    """Return a Cooke triplet, 50 mm f/5, with the stop behind the second element."""
    return lens_of(
        [
            (22.01359, 3.25896, "N-SK16", 9.5),
            (-435.76044, 6.00755, AIR, 9.0),
            (-22.21328, 0.99997, "N-F2", 5.0),
            (20.29192, 0.5, AIR, 5.0),
            (0.0, 4.25, AIR, 4.0),
            (79.68360, 2.95208, "N-SK16", 8.0),
            (-18.39533, 42.20778, AIR, 8.0),
        ],
        stop=4,
    )


def plano_hyperbolic(wavelength: float) -> Lens:
    """Return a lens without spherical aberration at one wavelength; its rear surface is a hyperboloid (k = -n^2)."""
    n = refractive_index("N-BK7", wavelength)
    radius = -20.0
    rows = [(0.0, 1.0, AIR, 15.0), (0.0, 12.0, "N-BK7", 15.0), (radius, radius / (1.0 - n), AIR, 15.0)]
    return lens_of(rows, stop=0, conics={2: -n * n})


def thin_lens(shape: float, focal_length: float, wavelength: float) -> Lens:
    """Return a very thin N-BK7 lens with shape factor q = (r2 + r1) / (r2 - r1) and the stop in contact with the
    lens.
    """
    n = refractive_index("N-BK7", wavelength)
    strength = 1.0 / (2.0 * focal_length * (n - 1.0))
    first, second = strength * (shape + 1.0), strength * (shape - 1.0)
    rows = [
        (0.0, 0.0, AIR, 1.0),
        (math.inf if first == 0 else 1.0 / first, 1e-9, "N-BK7", 30.0),
        (math.inf if second == 0 else 1.0 / second, focal_length, AIR, 30.0),
    ]
    return lens_of(rows, stop=0)

"""The PSFs of a lens, and the blur compared with simple float64 references."""

import math
from fractions import Fraction

import numpy as np
import pytest
import skimage.data

from robustflow.corruptions.kernels.cache import BytesCache
from robustflow.corruptions.optics import blur as engine
from robustflow.corruptions.optics.blur import LENGTHS, blur, twiddles
from robustflow.corruptions.optics.design import shipped_lens
from robustflow.corruptions.optics.psf_field import (
    PsfField,
    grid_of,
    half_digest,
    halved,
    manifest,
    shipped_field,
)
from robustflow.corruptions.optics.render import render_psfs

from ..pictures import noise
from .naive_blur import blended_blur, blurred_pixels


def point_field(shift_rows: int = 0) -> PsfField:
    """Return PSFs with a single non-zero pixel, which is shifted away from the image centre."""
    stack = np.zeros((64, 3, 61, 61))
    stack[:, :, 30 + shift_rows, 30] = 1.0
    return PsfField(stack)


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
def test_error_against_exact_kernels_is_below_rounding(severity):
    """Errors are in grey levels, at points distributed over a photograph."""
    field, frame = shipped_field(severity), skimage.data.astronaut()
    points = np.random.default_rng(severity).integers(0, 512, (120, 2))
    got = blur(frame, field)[points[:, 1], points[:, 0]]
    error = got - blurred_pixels(frame, field.stack, points)
    assert np.sqrt((error**2).mean()) <= 0.15
    assert np.abs(error).max() <= 3.0


def black_and_white(height: int, width: int) -> np.ndarray:
    return noise(height, width) // 128 * 255


def board(height: int, width: int) -> np.ndarray:
    return np.indices((height, width, 3))[:2].sum(0).astype(np.uint8) % 2 * 255


@pytest.mark.parametrize("picture", [noise, black_and_white, board])
@pytest.mark.parametrize(
    ("shape", "severity"),
    [((70, 111), 1), ((111, 64), 3), ((131, 90), 5), ((1, 1), 4), ((1, 90), 4), ((61, 2), 4), ((33, 64), 4),
     ((150, 31), 4)],
)  # fmt: skip
def test_blur_of_any_picture_equals_the_float64_reference(picture, shape, severity):
    """Single precision causes an error of at most 2e-4 grey levels, a thousandth of the interpolation error."""
    frame, field = picture(*shape), shipped_field(severity)
    assert np.abs(blur(frame, field) - blended_blur(frame, field.stack)).max() < 2e-4


def test_kernels_with_negative_values_equal_the_float64_reference():
    stack = np.random.default_rng(0).normal(1.0, 0.8, (64, 3, 61, 61))
    field, frame = PsfField(stack + stack[..., ::-1]), noise(60, 91)  # lenses are rotationally symmetric
    assert np.abs(blur(frame, field) - blended_blur(frame, field.stack)).max() < 2e-4


def test_a_psf_displaced_outwards_moves_light_outwards():
    """The rows of the stack point away from the image centre in every direction."""
    field = point_field(shift_rows=6)
    rows, columns = np.mgrid[:401, :601]
    for dy, dx in ((120, 0), (-120, 0), (0, 200), (0, -200), (120, 160)):
        frame = np.zeros((401, 601, 3), np.uint8)
        frame[200 + dy, 300 + dx] = 255
        light = blur(frame, field).sum(2)
        light /= light.sum()
        moved = np.array([(light * rows).sum() - 200 - dy, (light * columns).sum() - 300 - dx])
        assert moved == pytest.approx(6.0 * np.array([dy, dx]) / np.hypot(dy, dx), abs=0.5)


def test_blur_without_cache_is_bit_identical(monkeypatch):
    frame, field = noise(150, 222), shipped_field(2)
    monkeypatch.setattr(engine, "CACHE", BytesCache(limit=2**28))
    first = blur(frame, field)
    assert engine.CACHE.nbytes > 0
    assert (blur(frame, field) == first).all()
    monkeypatch.setattr(engine, "CACHE", BytesCache(limit=0))
    assert (blur(frame, field) == first).all()
    assert engine.CACHE.nbytes == 0


def test_cache_over_its_limit_drops_the_least_recently_used():
    def kernels(count: int):
        return lambda: np.zeros(count, np.float32)

    cache = BytesCache(limit=100)
    for name in "abc":
        cache.get(name, kernels(12))
        cached = cache.get("a", kernels(12))
    assert cache.nbytes <= 100
    assert cache.get("a", kernels(1)) is cached
    assert cache.get("b", kernels(1)).size == 1
    assert cache.get("large", kernels(30)).size == 30
    assert cache.nbytes <= 100


SEVERITIES = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("severity", SEVERITIES)
def test_shipped_psfs_are_normalised_symmetric_and_centred(severity):
    field = shipped_field(severity)
    assert field.stack.shape == (64, 3, 61, 61)
    assert field.stack.dtype == np.float32
    assert field.stack.min() >= 0.0
    assert field.stack.astype(float).sum((2, 3)) == pytest.approx(1.0, abs=1e-6)
    assert (field.stack == field.stack[..., ::-1]).all()
    green = field.stack[:, 1].astype(float).sum(2)
    assert np.abs(green @ np.arange(-30, 31)).max() <= 0.05, "the ground truth remains valid"


@pytest.mark.slow
@pytest.mark.parametrize("severity", SEVERITIES)
def test_every_lens_renders_to_the_shipped_bytes(severity):
    assert half_digest(halved(render_psfs(shipped_lens(severity)))) == manifest()[f"psf_s{severity}"]


@pytest.mark.parametrize("length", LENGTHS)
def test_twiddles_are_decided_by_more_than_the_last_bits_of_sine_and_cosine(length):
    """An error of ten units in the last place of a double, larger than in any math library, does not change any
    float32 value.
    """
    for k, pair in enumerate(twiddles(length)):
        angle = 2.0 * math.pi * k / length
        for value, exact in zip(pair, (math.cos(angle), -math.sin(angle)), strict=True):
            slack = 10 * math.ulp(1.0)  # includes the error of the angle
            assert np.float32(exact - slack) == np.float32(exact + slack) == value or abs(exact) < 1e-12, Fraction(
                k, length
            )


def test_nodes_lie_closer_in_small_images():
    pitches = [grid_of(side, side) for side in (16, 300, 700, 1000, 1200, 2000, 5000)]
    assert pitches == sorted(pitches)
    assert (pitches[0], pitches[-1]) == (12, 34)

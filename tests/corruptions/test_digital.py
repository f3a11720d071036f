"""Compare saturate with exact fractions, and elastic_transform with SciPy's filters and `map_coordinates`."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions import load_corruption
from robustflow.corruptions.digital import ElasticTransform, Saturate
from robustflow.corruptions.kernels.fields import field_row, smooth_field

COLOURS = np.random.default_rng(5).integers(0, 256, (64, 97, 3), dtype=np.uint8)


def exact_saturation(pixel, alpha, beta):
    """Compute the paper's S' = S alpha + beta, with V and hue unchanged, in exact fractions; round half to even."""
    top, low = max(pixel), min(pixel)
    if top == 0:
        return [0, 0, 0]
    chroma = top * min(Fraction(top - low, top) * alpha + beta, 1)
    if top == low:  # grey has a hue of 0, so red is unchanged, and green and blue decrease
        return [round(top), round(top - chroma), round(top - chroma)]
    return [round(top - chroma * Fraction(top - channel, top - low)) for channel in pixel]


@pytest.mark.parametrize("parameter", [*load_corruption("saturate").severities, (1.37, 0.0321), (0.0, 1.0)])
def test_saturate_equals_the_formula_to_half_a_level(parameter):
    greys = np.arange(256, dtype=np.uint8)[:, None].repeat(3, axis=1)
    pixels = np.concatenate([greys, COLOURS.reshape(-1, 3)[:1500], COLOURS.reshape(-1, 3)[:500] // 32])
    alpha, beta = (Fraction(str(value)) for value in parameter)
    saturate = Saturate(severities=(parameter,) * 5)
    found = saturate.apply(pixels[None], saturate.parameter(1), 0)[0]
    for pixel, values in zip(pixels.tolist(), found.tolist(), strict=True):
        assert values == exact_saturation(pixel, alpha, beta), pixel


def noise_of(rng, height, width):
    """Return the noise before blurring: 16 bits of the stream per pixel; each row starts with a new 64-bit value."""
    words = (width + 3) // 4
    bits = np.array([hash64(np.uint64(rng.key), np.uint64(i)) for i in range(height * words)], np.uint64)
    return bits.astype("<u8").view("<i2").reshape(height, 4 * words)[:, :width] / 32768


def rows_of(field, height, width):
    out = np.empty((height, width), np.float32)
    for y in range(height):
        field_row(*field, y, out[y])
    return out


def displacement(state, shape):
    """Return the displacement at every pixel, float32 (H, W, 2): (dx, dy) in pixels."""
    return np.stack([rows_of(state.dx, *shape), rows_of(state.dy, *shape)], axis=-1)


@pytest.mark.parametrize(
    ("shape", "sigmas"),
    [((60, 90), (0.6, 0.9)), ((75, 130), (3.75, 12.4)), ((150, 170), (21.6, 9.0)), ((16, 16), (0.16, 0.16))],
)
def test_the_field_is_blurred_noise(shape, sigmas):
    rng = Rng.of("field", *shape)
    expected = 10 * gaussian_filter(noise_of(rng, *shape), sigmas, mode="reflect", truncate=3)
    got = rows_of(smooth_field(rng, shape, sigmas, 10.0), *shape)
    # the kernel is cut off at 0.011 of its maximum, and interpolation smooths that step
    assert np.sqrt(np.mean((got - expected) ** 2)) < 0.01 * expected.std()


@settings(max_examples=20)
@given(st.integers(16, 70), st.integers(16, 70), st.integers(1, 5), st.sampled_from(["default", "reference"]))
def test_the_warp_is_bilinear_with_mirrored_borders(height, width, severity, variant):
    frame = np.random.default_rng(height).integers(0, 256, (height, width, 3), dtype=np.uint8)
    elastic = ElasticTransform(variant)
    state = elastic.draw(Rng.of("warp", width), severity, (height, width))
    field = displacement(state, (height, width)).astype(np.float64)
    y, x = np.mgrid[:height, :width]
    at = [y + field[..., 1], x + field[..., 0]]
    expected = [map_coordinates(frame[..., c].astype(np.float64), at, order=1, mode="reflect") for c in range(3)]
    # half a grey level for rounding, and 255 / 4096 of a level for the rounded position along each axis
    assert np.abs(elastic.apply(frame, state, 0) - np.stack(expected, axis=-1)).max() < 0.5 + 2 * 255 / 4096 + 0.01


def test_the_paper_displaces_ten_times_as_far_as_the_code():
    rng = Rng.of("scale")
    paper = displacement(ElasticTransform().draw(rng, 3, (50, 80)), (50, 80))
    code = displacement(ElasticTransform("reference").draw(rng, 3, (50, 80)), (50, 80))
    assert np.allclose(paper, 10 * code, rtol=1e-4)

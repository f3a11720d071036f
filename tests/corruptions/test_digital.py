"""Compare digital and illumination corruptions with Pillow, exact fractions, HSV round trips and `map_coordinates`."""

import io
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage.color import hsv2rgb, rgb2hsv

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.digital import ElasticTransform, Saturate
from robustflow.corruptions.kernels.fields import field_row, smooth_field

SEVERITIES = (1, 2, 3, 4, 5)
COLOURS = np.random.default_rng(5).integers(0, 256, (64, 97, 3), dtype=np.uint8)


def corrupted(corruption, frame, severity):
    return corruption.apply(frame, corruption.draw(Rng.of(0), severity, frame.shape[:2]), 0)


def smooth(height, width, seed):
    coarse = np.random.default_rng(seed).integers(0, 256, (height // 8 + 2, width // 8 + 2, 3), dtype=np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((width, height), Image.Resampling.BICUBIC))


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("size", [(375, 1242), (97, 131), (16, 16), (17, 33)])
def test_jpeg_compression_equals_pillow(severity, size):
    frame = smooth(*size, severity)
    for variant in ("default", "reference"):
        corruption = load_corruption("jpeg_compression", variant)
        file = io.BytesIO()
        Image.fromarray(frame).save(file, "JPEG", quality=corruption.parameter(severity))
        assert (corrupted(corruption, frame, severity) == np.asarray(Image.open(file))).all()


@settings(max_examples=60)
@given(st.integers(16, 260), st.integers(16, 260), st.sampled_from(SEVERITIES))
def test_pixelate_equals_pillow_with_columns_first(height, width, severity):
    frame = np.random.default_rng(height * 1000 + width).integers(0, 256, (height, width, 3), dtype=np.uint8)
    corruption = load_corruption("pixelate")
    factor = corruption.parameter(severity)
    narrow = Image.fromarray(frame).resize((int(width * factor), height), Image.Resampling.BOX)
    small = narrow.resize((int(width * factor), int(height * factor)), Image.Resampling.BOX)
    expected = np.asarray(small.resize((width, height), Image.Resampling.NEAREST))
    assert (corrupted(corruption, frame, severity) == expected).all()


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("variant", ["default", "reference", "paper"])
@pytest.mark.parametrize("width", [64, 65, 129, 300])
def test_contrast_equals_the_formula(severity, variant, width):
    frame = np.random.default_rng(width).integers(0, 200, (37, width, 3), dtype=np.uint8)
    frame[..., 2] //= 3
    corruption = load_corruption("contrast", variant)
    image = frame.astype(np.float64)
    mean = image.mean() if variant == "paper" else image.mean(axis=(0, 1))
    expected = (image - mean) * corruption.parameter(severity) + mean
    off = corrupted(corruption, frame, severity) - expected
    low, high = (-1, 0) if variant == "reference" else (-0.5, 0.5)
    assert off.min() >= low - 1e-9
    assert off.max() <= high + 1e-9


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
    found = corrupted(Saturate(severities=(parameter,) * 5), pixels[None], 1)[0]
    for pixel, values in zip(pixels.tolist(), found.tolist(), strict=True):
        assert values == exact_saturation(pixel, alpha, beta), pixel


EXPOSURES = ("over_exposure", "under_exposure")


def exposed(name, severity):
    """Return the corruption and a state that corrupts frame 0."""
    corruption = load_corruption(name)
    states = (corruption.draw(Rng.of(seed), severity, (64, 97)) for seed in range(100))
    return corruption, next(state for state in states if not getattr(state, "exposed", 0))


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize(("name", "sign"), [("high_light", 1), ("low_light", -1)])
def test_shift_of_v_equals_the_formula_to_half_a_level(name, sign, severity):
    corruption, state = exposed(name, severity)
    shift = sign * 255 * Fraction(str(corruption.parameter(severity)))
    pixels = np.concatenate([np.zeros((1, 3), np.uint8), COLOURS.reshape(-1, 3)[:3000]])
    for pixel, found in zip(pixels.tolist(), corruption.apply(pixels[None], state, 0)[0].tolist(), strict=True):
        value = max(pixel)
        new = min(max(value + shift, 0), 255)
        assert found == [round(Fraction(channel * new, value) if value else new) for channel in pixel], pixel


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("name", EXPOSURES)
def test_hsv_conversion_survives_a_round_trip(name, severity):
    corruption, state = exposed(name, severity)
    hsv = rgb2hsv(COLOURS)
    hsv[..., 2] = np.minimum(hsv[..., 2] * 2.0 ** corruption.parameter(severity), 1)
    off = corruption.apply(COLOURS, state, 0) - hsv2rgb(hsv) * 255
    assert np.abs(off).max() < 0.5 + 1e-9


@pytest.mark.parametrize("name", EXPOSURES)
def test_exposed_frame_is_drawn_with_equal_probability(name):
    which = []
    for seed in range(200):
        first, second = corrupt(COLOURS, COLOURS, name, 3, seed=seed)
        changed = [not (frame == COLOURS).all() for frame in (first, second)]
        assert sum(changed) == 1
        which.append(changed[1])
    assert 65 < sum(which) < 135


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

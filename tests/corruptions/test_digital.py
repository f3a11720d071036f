"""Compare digital corruptions with Pillow, a naive float64 loop and exact fractions."""

import io
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from robustflow.core.rng import Rng
from robustflow.corruptions import load_corruption
from robustflow.corruptions.digital.tone import Saturate

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


def test_reference_variant_of_saturate_swaps_the_two_mildest_severities():
    paper, code = load_corruption("saturate"), load_corruption("saturate", "reference")
    assert [code.parameter(s) for s in SEVERITIES] == [paper.parameter(s) for s in (2, 1, 3, 4, 5)]

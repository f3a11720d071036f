"""Compare the shuffle with simple loops over pixels, and test the blurs before and after it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions.blur.glass_blur import GlassBlur, draw_shuffle


def shuffled_by_loops(pixels, rng, reach, iterations, swap):
    """Shuffle pixel by pixel, starting at the bottom right, with offsets from the stream."""
    pixels = pixels.copy()
    height, width = pixels.shape[:2]
    for iteration in range(iterations):
        key = np.uint64(rng.spawn("shuffle", iteration).key)
        count = 0
        for y in range(height - reach, reach, -1):
            for x in range(width - reach, reach, -1):
                word = int(hash64(key, np.uint64(count // 4))) >> (16 * (count % 4)) & 0xFFFF
                count += 1
                dy, dx = divmod(word * (2 * reach) ** 2 >> 16, 2 * reach)
                there = y + dy - reach, x + dx - reach
                old = pixels[y, x].copy()
                pixels[y, x] = pixels[there]
                if swap:
                    pixels[there] = old
    return pixels


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(("reach", "iterations"), [(1, 2), (2, 1), (4, 2)])
def test_index_map_equals_the_naive_loop(reach, iterations, swap):
    rng = Rng.of("glass", reach)
    numbers = np.arange(23 * 31).reshape(23, 31)
    expected = shuffled_by_loops(numbers, rng, reach, iterations, swap)
    assert np.array_equal(draw_shuffle(rng, (23, 31), reach, iterations, swap), expected)


def test_a_swap_keeps_every_pixel_and_a_copy_loses_half():
    rng = Rng.of("glass")
    swapped = draw_shuffle(rng, (60, 80), 2, 3, swap=True)
    assert np.array_equal(np.sort(swapped.ravel()), np.arange(60 * 80))
    copied = draw_shuffle(rng, (60, 80), 2, 3, swap=False)
    survivors = len(np.unique(copied)) / copied.size
    assert 0.2 < survivors < 0.6


@pytest.mark.parametrize("variant", ["default", "paper"])
def test_the_frame_is_blurred_floored_shuffled_and_blurred(variant):
    frame = np.random.default_rng(3).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    glass = GlassBlur(variant)
    rng = Rng.of("whole")
    sigma, reach, iterations = glass.parameter(5)
    blurred = np.floor(gaussian_filter(frame.astype(np.float64), (sigma, sigma, 0), mode="nearest") + 1e-3)
    moved = shuffled_by_loops(blurred, rng, reach, iterations, swap=variant == "paper")
    expected = gaussian_filter(moved, (sigma, sigma, 0), mode="nearest")
    got = glass.apply(frame, glass.draw(rng, 5, (40, 50)), 0)
    assert np.abs(got - expected).max() < 0.501


def test_glass_blur_keeps_a_white_frame_white():
    white = np.full((32, 32, 3), 255, np.uint8)
    glass = GlassBlur()
    for severity in (1, 2, 3, 4, 5):
        assert (glass.apply(white, glass.draw(Rng.of(0), severity, (32, 32)), 0) == 255).all()

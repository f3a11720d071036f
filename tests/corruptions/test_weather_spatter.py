"""Compare spatter with the steps of the reference code in float64, using the same noise."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from robustflow.core.rng import Rng
from robustflow.corruptions.kernels.fields import UNIT, normal_field
from robustflow.corruptions.weather.spatter import MUD, WATER, Spatter, chamfer_distance, mean_distance


def naive(frame, rng, parameter):
    mean, deviation, sigma, threshold, strength, mud = parameter
    noise = mean + deviation * UNIT * normal_field(rng, *frame.shape[:2])
    liquid = gaussian_filter(noise, sigma, mode="nearest", truncate=4)
    liquid[liquid < threshold] = 0
    frame = frame.astype(np.float64)
    if mud:
        opacity = gaussian_filter((liquid > threshold).astype(np.float64), strength, mode="nearest", truncate=4)
        opacity = np.where(opacity < 0.8, 0, opacity)[..., None]
        return np.clip(frame * (1 - opacity) + opacity * MUD, 0, 255)
    liquid = (liquid * 255).astype(np.uint8)
    distance = cv2.distanceTransform(255 - cv2.Canny(liquid, 50, 150), cv2.DIST_L2, 5)
    near = cv2.equalizeHist(cv2.blur(np.minimum(distance, 20), (3, 3)).astype(np.uint8))
    relief = cv2.filter2D(near, cv2.CV_8U, np.array([[-2, -1, 0], [-1, 1, 1], [0, 1, 2]]))
    opacity = liquid * cv2.blur(relief, (3, 3)).astype(np.float64)
    opacity *= strength / max(opacity.max(), 1)
    return np.clip(frame + opacity[..., None] * WATER, 0, 255)


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
def test_spatter_equals_the_reference(severity):
    spatter, shape = Spatter(), (120, 170)
    frame = np.random.default_rng(severity).integers(0, 256, (*shape, 3), dtype=np.uint8)
    expected = naive(frame, Rng.of("spatter"), spatter.parameter(severity))
    got = spatter.apply(frame, spatter.draw(Rng.of("spatter"), severity, shape), 0)
    assert np.abs(expected - frame).max() > 30
    # rounding errors can move values that are close to a threshold across it
    assert (np.abs(got - expected) > 0.51).mean() < 0.005


def test_spatter_without_a_drop_leaves_the_frame_unchanged():
    spatter = Spatter(severities=((0.1, 0.01, 2.0, 0.9, 0.6, False),) * 5)
    frame = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    assert np.array_equal(spatter.apply(frame, spatter.draw(Rng.of(0), 1, (16, 16)), 0), frame)


def test_mud_covers_in_rgb_order():
    spatter = Spatter()
    white = np.full((100, 100, 3), 255, np.uint8)
    muddy = spatter.apply(white, spatter.draw(Rng.of(3), 5, (100, 100)), 0).reshape(-1, 3)
    assert muddy[muddy[:, 0].argmin()].tolist() == [63, 42, 20]


def test_distances_equal_those_of_opencv():
    edges = (np.random.default_rng(1).random((50, 70)) > 0.995).astype(np.uint8) * 255
    expected = np.minimum(cv2.distanceTransform(255 - edges, cv2.DIST_L2, 5), 20)
    assert np.abs(chamfer_distance(edges, 20) / 10_000 - expected).max() < 2e-4


def test_means_are_rounded_down():
    values = np.random.default_rng(2).integers(0, 200_001, (9, 13)).astype(np.int32)
    padded = np.pad(values, 1, mode="reflect")
    sums = sum(padded[i : i + 9, j : j + 13] for i in range(3) for j in range(3))
    assert np.array_equal(mean_distance(values), sums // 90_000)

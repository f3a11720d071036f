"""Compare fog, snow and spatter with the steps of the reference code in float64, using the same noise."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.ndimage import zoom as scipy_zoom

from robustflow.core.rng import Rng, hash64
from robustflow.corruptions.kernels.fields import UNIT, normal_field, plasma_corner
from robustflow.corruptions.weather.fog import Fog
from robustflow.corruptions.weather.snow import Snow
from robustflow.corruptions.weather.spatter import MUD, WATER, Spatter

from .pictures import moved_along_a_line


def whole_map(rng, size, decay):
    """Run the diamond-square algorithm on a torus of `size` points, in float64 with rolled arrays, without scaling."""
    grid = np.zeros((1, 1))
    level = 0
    while len(grid) < size:
        points = len(grid)
        key = np.uint64(rng.spawn("plasma", level).key)
        bits = np.array([hash64(key, np.uint64(i)) for i in range(points**2)], np.uint64).reshape(points, points)
        amplitude = (100 / decay**level) ** 2
        noise = [amplitude * (((bits >> np.uint64(s)) & np.uint64(0xFFFF)) / 32768 - 1) for s in (0, 16, 32)]
        south, east = np.roll(grid, -1, 0), np.roll(grid, -1, 1)
        centre = (grid + south + east + np.roll(south, -1, 1)) / 4 + noise[0]
        fine = np.empty((2 * points, 2 * points))
        fine[::2, ::2], fine[1::2, 1::2] = grid, centre
        fine[::2, 1::2] = (grid + east + centre + np.roll(centre, 1, 0)) / 4 + noise[1]
        fine[1::2, ::2] = (grid + south + centre + np.roll(centre, 1, 1)) / 4 + noise[2]
        grid, level = fine, level + 1
    return grid


@pytest.mark.parametrize(("shape", "size"), [((16, 16), 16), ((20, 33), 64), ((130, 17), 256)])
def test_corner_of_a_small_fog_map_equals_the_whole_map(shape, size):
    rng = Rng.of("plasma", size)
    expected = whole_map(rng, size, 1.7)
    expected = (expected - expected.min()) / (expected.max() - expected.min())
    assert np.abs(plasma_corner(rng, *shape, 1.7) - expected[: shape[0], : shape[1]]).max() < 1e-5


def test_corner_of_a_large_fog_map_is_scaled_by_its_own_extremes():
    rng = Rng.of("large")
    expected = whole_map(rng, 1024, 1.4)
    low, span = expected.min(), expected.max() - expected.min()
    for height, width in ((40, 1000), (700, 600)):
        got = plasma_corner(rng, height, width, 1.4)
        seen = expected[:height, :width]
        assert np.corrcoef(got.ravel(), seen.ravel())[0, 1] > 0.999999
        assert np.abs(got - (seen - low) / span).max() < 0.002


@settings(max_examples=25)
@given(st.integers(1, 5), st.integers(0, 255), st.integers(0, 9))
def test_fog_is_blended_by_the_formula(severity, brightest, seed):
    frame = np.random.default_rng(seed).integers(0, brightest + 1, (20, 30, 3)).astype(np.uint8)
    fog = Fog()
    state = fog.draw(Rng.of("blend", seed), severity, (20, 30))
    strength = fog.parameter(severity)[0]
    top = frame.max() / 255
    expected = 255 * (frame / 255 + strength * state[1][..., None].astype(np.float64)) * top / (top + strength)
    assert np.abs(fog.apply(frame, state, 0) - np.clip(expected, 0, 255)).max() < 0.501


def naive_layer(field, parameter, angle, shape):
    mean, deviation, zoom, threshold, radius, sigma, _ = parameter
    layer = scipy_zoom(mean + deviation * field, zoom, order=1)
    layer = np.where(layer < threshold, 0, np.clip(layer, 0, 1))
    return np.rint(moved_along_a_line(layer, radius, sigma, angle) * 255)[: shape[0], : shape[1]]


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("shape", [(16, 16), (47, 83)])
def test_snow_equals_the_formula_of_the_reference(severity, shape):
    snow, rng = Snow(), Rng.of("snow", severity)
    frame = np.random.default_rng(severity).integers(0, 256, (*shape, 3), dtype=np.uint8)
    state = snow.draw(rng, severity, shape)
    parameter = snow.parameter(severity)
    zoom, share = parameter[2], parameter[6]
    rows, columns = math.ceil(shape[0] / zoom), math.ceil(shape[1] / zoom)
    field = normal_field(state.flakes.spawn("frame", 1), rows, columns) * UNIT
    layer = naive_layer(field, parameter, Rng.of("snow", severity).uniform(-135, -45), shape)[..., None]
    grey = (frame @ np.array([0.299, 0.587, 0.114]))[..., None]
    expected = share * frame + (1 - share) * np.maximum(frame, 1.5 * grey + 127.5) + layer + layer[::-1, ::-1]
    error = np.abs(snow.apply(frame, state, 1) - np.minimum(expected, 255))
    # both layers are rounded sums with an error of up to 0.05, so values close to one half may be rounded up or down
    assert error.max() < 2.6
    assert (error > 0.51).mean() < 2 * 2 * 0.05


def test_normal_fields_have_the_moments_and_tails_of_a_normal():
    field = normal_field(Rng.of("moments"), 500, 401).ravel() * UNIT
    assert abs(field.mean()) < 0.01
    assert abs(field.std() - 1) < 0.01
    assert abs(np.mean(field**4) - 3) < 0.1
    assert abs(np.mean(field > 1.959964) - 0.025) < 0.002
    assert abs(np.corrcoef(field[:-1], field[1:])[0, 1]) < 0.01


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

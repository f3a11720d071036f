"""Test RAW noise: sensor statistics, the round trip, and each step against an independent reference."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.ndimage import convolve

from robustflow.core.rng import Rng
from robustflow.corruptions import load_corruption
from robustflow.corruptions.sensor.camera import (
    BLACK,
    NOISELESS,
    WHITE,
    CameraColours,
    Sensor,
    bytes_of_linear,
    draw_camera,
    exposed,
    linear_of_bytes,
    sensor_at,
)
from robustflow.corruptions.sensor.raw_noise import KNEE, RawState, developed, light_on_sensor

from .pictures import picture

SPAN = WHITE - BLACK
ISO = load_corruption("raw_noise").severities


def flat(light, sensor, key, shape=(500, 800)):
    return exposed(np.full(shape, light, np.float32), sensor, np.uint64(key)).astype(np.float64)


@pytest.mark.parametrize("iso", ISO)
def test_the_photon_transfer_curve_has_the_sensors_gain_and_read_noise(iso):
    """The variance of uniform RAW patches is linear in their mean.

    The slope is the gain, and the value at zero light is the read noise.
    """
    sensor = sensor_at(iso)
    levels = np.array([0.0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5])
    patches = [flat(level, sensor, key) for key, level in enumerate(levels)]
    means, variances = np.array([[patch.mean() - BLACK, patch.var()] for patch in patches]).T
    slope, at_black = np.polyfit(means, variances, 1, w=1 / variances)
    assert slope == pytest.approx(SPAN * sensor.shot, rel=0.01)
    assert np.sqrt(at_black - 1 / 12) == pytest.approx(SPAN * sensor.read, rel=0.02)
    np.testing.assert_allclose(means, SPAN * levels, atol=5 * np.sqrt(variances.max() / patches[0].size))


@pytest.mark.parametrize("mean", [0.4, 3.7, 20.3, 63.9])
def test_few_electrons_are_poisson_distributed_exactly(mean):
    sensor = Sensor(shot=1 / 100, read=0.0)
    counts = np.rint((flat(mean / 100, sensor, 1) - BLACK) * 100 / SPAN).astype(int).ravel()
    expected = stats.poisson.pmf(np.arange(101), mean) * counts.size
    found = np.bincount(counts, minlength=101)
    kept = expected > 10
    assert stats.chisquare(found[kept], expected[kept] * found[kept].sum() / expected[kept].sum()).pvalue > 1e-3
    assert counts.mean() == pytest.approx(mean, abs=4 * np.sqrt(mean / counts.size))


@pytest.mark.parametrize("mean", [64.1, 200.0])
def test_many_electrons_are_close_to_poisson_distributed(mean):
    sensor = Sensor(shot=1 / 400, read=0.0)
    counts = np.rint((flat(mean / 400, sensor, 2) - BLACK) * 400 / SPAN).astype(int).ravel()
    cdf = np.cumsum(np.bincount(counts, minlength=500)) / counts.size
    assert np.abs(cdf - stats.poisson.cdf(np.arange(len(cdf)), mean)).max() < 2 / np.sqrt(counts.size)
    assert stats.skew(counts) == pytest.approx(mean**-0.5, abs=0.02)


def test_the_tone_curve_is_that_of_the_paper():
    shown = np.arange(256) / 255
    expected = (0.5 - np.sin(np.arcsin(1 - 2 * shown) / 3)) ** 2.2
    np.testing.assert_allclose(linear_of_bytes(), expected, rtol=1e-6, atol=1e-12)
    light = (np.arange(len(bytes_of_linear())) + 0.5) / len(bytes_of_linear())
    v = light ** (1 / 2.2)
    np.testing.assert_array_equal(bytes_of_linear(), np.rint(255 * (3 * v**2 - 2 * v**3)))


@given(st.integers(0, 10**6))
def test_a_drawn_camera_can_be_inverted_and_holds_every_colour(seed):
    camera = draw_camera(Rng.of("camera", seed))
    np.testing.assert_allclose(camera.to_srgb, np.linalg.inv(camera.from_srgb), atol=1e-12)
    np.testing.assert_allclose(camera.from_srgb.sum(axis=1), 1)
    assert (camera.from_srgb >= 0).all()
    red, green, blue = camera.gains
    assert 0.6 <= green <= 1
    assert 1.9 <= green / red <= 2.4
    assert 1.5 <= green / blue <= 1.9


def test_light_on_the_sensor_is_that_of_the_paper_below_the_knee():
    frame = picture(31, 46)
    frame = np.minimum(frame, 240)
    camera = draw_camera(Rng.of("light"))
    colours = linear_of_bytes()[frame].astype(np.float64) @ camera.from_srgb.T
    assert colours.max() < KNEE
    expected = np.empty(frame.shape[:2])
    for dy, dx, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):  # RGGB
        expected[dy::2, dx::2] = (colours * camera.gains)[dy::2, dx::2, channel]
    np.testing.assert_allclose(light_on_sensor(frame, camera), expected, rtol=1e-5, atol=1e-7)


def test_demosaicing_is_that_of_malvar_he_and_cutler():
    """Compare demosaicing with the paper's 5x5 kernels, applied by SciPy, for a camera that does not change colours."""
    camera = CameraColours(np.eye(3), np.eye(3), np.ones(3))
    raw = np.random.default_rng(0).integers(BLACK, BLACK + SPAN // 2, (26, 33)).astype(np.uint16)
    light = (raw.astype(np.float64) - BLACK) / SPAN
    green = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8
    row = np.array([[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]]) / 16
    far = np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]])
    by_green, by_row, by_column, by_far = (convolve(light, k, mode="mirror") for k in (green, row, row.T, far / 8))
    y, x = np.mgrid[:26, :33] % 2
    even, odd, at_green = (y == 0) & (x == 0), (y == 1) & (x == 1), y != x
    expected = np.stack(
        [
            np.select([even, odd, y == 0], [light, by_far, by_row], by_column),
            np.where(at_green, light, by_green),
            np.select([odd, even, y == 1], [light, by_far, by_row], by_column),
        ],
        axis=-1,
    )
    levels = len(bytes_of_linear())
    shown = bytes_of_linear()[np.clip(np.floor(expected * levels), 0, levels - 1).astype(int)]
    difference = np.abs(developed(raw, camera, NOISELESS).astype(int) - shown)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.001  # at the boundary between two parts of the table


@pytest.mark.parametrize(("noise", "most", "mean"), [(1e-9, 1, 0.02), (1e-7, 2, 0.1), (1e-6, 6, 0.25)])
def test_frame_is_unchanged_in_the_limit_of_no_noise(noise, most, mean):
    """The remaining differences of a level come from the rounding to 14 bits."""
    corruption, frame = load_corruption("raw_noise"), picture(100, 120)
    state = RawState(draw_camera(Rng.of("vanishing")), Sensor(noise, noise), Rng.of("noise"))
    difference = np.abs(corruption.apply(frame, state, 0).astype(int) - frame)
    assert difference.max() <= most
    assert difference.mean() < mean

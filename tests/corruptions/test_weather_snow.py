"""Compare snow with the steps of the reference code in float64, using the same flakes."""

import math

import numpy as np
import pytest
from scipy.ndimage import zoom as scipy_zoom

from robustflow.core.rng import Rng
from robustflow.corruptions.kernels.fields import UNIT, normal_field
from robustflow.corruptions.weather.snow import Snow

from .line_motion import moved_along_a_line


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


def test_flakes_differ_between_frames():
    snow = Snow()
    black = np.zeros((120, 160, 3), np.uint8)
    state = snow.draw(Rng.of("pair"), 4, (120, 160))
    first, second = (snow.apply(black, state, index).astype(float).ravel() for index in (0, 1))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.2


def test_the_direction_is_downward():
    ends = np.array([Snow().draw(Rng.of(seed), 5, (64, 64)).motion.offsets[-1] for seed in range(100)])
    assert (ends[:, 0] < 0).all()
    assert (ends[:, 1] < -8).any()
    assert (ends[:, 1] > 8).any()


def test_normal_fields_have_the_moments_and_tails_of_a_normal():
    field = normal_field(Rng.of("moments"), 500, 401).ravel() * UNIT
    assert abs(field.mean()) < 0.01
    assert abs(field.std() - 1) < 0.01
    assert abs(np.mean(field**4) - 3) < 0.1
    assert abs(np.mean(field > 1.959964) - 0.025) < 0.002
    assert abs(np.corrcoef(field[:-1], field[1:])[0, 1]) < 0.01

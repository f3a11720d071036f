"""Test the OpenCV methods on known motion."""

import cv2
import numpy as np
import pytest
from skimage import data

from robustflow import load_model
from robustflow.core.errors import UsageError

from ..refusals import refusal


@pytest.fixture(scope="module")
def moved():
    """A photograph moved by (5, -3) pixels."""
    texture = data.astronaut()
    return texture[100:356, 100:420].copy(), texture[103:359, 95:415].copy()


@pytest.mark.parametrize(
    ("name", "options", "tolerance"),
    [("farneback", {}, 0.5), ("dis", {}, 0.1), ("dis", {"preset": "fast"}, 0.2), ("dis", {"preset": "ultrafast"}, 0.4)],
)
def test_translation_to_the_right_and_up_is_recovered(moved, name, options, tolerance):
    flow = load_model(name, **options).predict(*moved)
    inside = flow[32:-32, 32:-32].reshape(-1, 2)
    np.testing.assert_allclose(np.median(inside, axis=0), (5, -3), atol=tolerance)


@pytest.mark.parametrize("name", ["farneback", "dis"])
def test_the_number_of_opencv_threads_changes_nothing(moved, name):
    before = cv2.getNumThreads()
    flows = []
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        flows.append(load_model(name).predict(*moved))
        assert cv2.getNumThreads() == threads, "the caller's setting must not change"
    cv2.setNumThreads(before)
    np.testing.assert_array_equal(*flows)


def test_flow_does_not_depend_on_the_previous_pair(moved):
    model = load_model("dis")
    first = model.predict(*moved)
    model.predict(moved[1], moved[0])
    np.testing.assert_array_equal(model.predict(*moved), first)


@pytest.mark.parametrize("model", [load_model(name) for name in ("farneback", "dis", "dis_rgb")])
@pytest.mark.parametrize(
    ("other", "culprit"),
    [
        (np.zeros((64, 95, 3), np.uint8), "(64, 95)"),
        (np.zeros((64, 96, 3)), "float64 (64, 96, 3)"),
        (np.zeros((64, 96), np.uint8), "uint8 (64, 96)"),
        ([[0]], "list"),
    ],
)
def test_invalid_frames_are_refused(model, other, culprit):
    refusal(lambda: model.predict(np.zeros((64, 96, 3), np.uint8), other), UsageError, culprit)


@pytest.mark.parametrize("preset", ["samples", "opencv"])
def test_farneback_presets_are_opencv_sample_and_default_values(preset):
    flow = cv2.FarnebackOpticalFlow.create()
    defaults = (flow.getNumLevels(), flow.getWinSize(), flow.getNumIters(), flow.getPolyN(), flow.getPolySigma())
    expected = {"opencv": defaults, "samples": (3, 15, 3, 5, 1.2)}[preset]
    names = ("levels", "winsize", "iterations", "poly_n", "poly_sigma")
    identity = load_model("farneback", preset=preset).identity()
    assert tuple(identity[name] for name in names) == expected
    assert identity["pyr_scale"] == flow.getPyrScale()
    assert load_model("farneback", preset=preset, winsize=21).identity() == {**identity, "winsize": 21}

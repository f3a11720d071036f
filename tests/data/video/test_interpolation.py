"""Test interpolation: the positions of frames, and the flow-based method on a scene with known ground truth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import AssetError, UsageError
from robustflow.data.video.interpolation import FlowInterpolator, interpolate, interpolated_count, load_interpolator
from tests.refusals import refusal

from .clips import Scene


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2)))


class Linear:
    """Cross-fading is exact for frames whose values are linear in time."""

    name = "linear"

    def between(self, window, factor):
        first, second = (frame.astype(float) for frame in window[1:3])
        return [np.rint(first + (second - first) * step / factor).astype(np.uint8) for step in range(1, factor)]

    def describe(self):
        return {"name": self.name}


@given(st.integers(4, 12), st.integers(2, 5))
def test_every_frame_is_at_its_time(count, factor):
    """Frame k of the result corresponds to source time 1 + k / factor.

    The first and last source frames are used only as neighbours.
    """
    source = [np.full((2, 2, 3), index * factor, np.uint8) for index in range(count)]
    result = [int(frame[0, 0, 0]) for frame in interpolate(source, Linear(), factor)]
    assert result == [factor + k for k in range(interpolated_count(count, factor))]
    assert result[-1] == (count - 2) * factor


@given(st.integers(0, 3))
def test_clip_shorter_than_the_window_gives_no_frames(count):
    assert list(interpolate([np.zeros((2, 2, 3), np.uint8)] * count, Linear(), 4)) == []
    assert interpolated_count(count, 4) <= 1


def test_flow_interpolation_has_a_much_higher_psnr_than_a_cross_fade():
    scene = Scene(160, 208, (4.0, 1.5), (-6.0, 3.0), turn=0.01)
    first, second = scene.frame(0), scene.frame(1)
    made = FlowInterpolator().between((first, first, second, second), 4)
    assert len(made) == 3
    for step, frame in enumerate(made, start=1):
        truth = scene.picture(step / 4)
        fade = first + (second.astype(float) - first) * step / 4
        assert psnr(frame, truth) > psnr(fade, truth) + 5


@pytest.mark.parametrize("shape", [(33, 47), (64, 16)])
def test_interpolation_keeps_odd_frame_sizes(shape):
    rng = np.random.default_rng(0)
    window = [rng.integers(0, 256, (*shape, 3), np.uint8) for _ in range(4)]
    made = FlowInterpolator().between(window, 2)
    assert [frame.shape for frame in made] == [(*shape, 3)]


def test_missing_interpolator_is_refused():
    assert load_interpolator(None, 1, None) is None
    for name, error, culprit in (
        (None, UsageError, "--interpolator"),
        ("dain", UsageError, "--interpolator"),
        ("flavr", AssetError, "--checkpoint"),
    ):
        refusal(lambda name=name: load_interpolator(name, 4, None), error, culprit)
    assert load_interpolator("flow", 4, None).describe()["name"] == "flow"

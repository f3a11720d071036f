"""Object motion blur and rolling shutter: their arithmetic, and the exact time integral of a moving scene."""

import numpy as np
import pytest

from robustflow.corruptions import load_corruption
from robustflow.data.video.interpolation import FlowInterpolator, interpolate
from robustflow.data.video.open_clip import mean_of_windows, row_offsets
from robustflow.data.video.prepared import REACH

from .clips import Scene

REACHES = load_corruption("object_motion_blur").severities
READOUTS = load_corruption("rolling_shutter").severities


@pytest.mark.slow
def test_four_times_the_frames_are_nearer_to_the_time_integral():
    """Compare the same exposure from interpolated frames (factor 4) and from the recorded frames alone (factor 1)."""
    figures = integral_psnr(Scene(120, 160, (2.0, 1.0), (-3.0, 1.5), turn=0.01))
    for reach, (four, one) in figures.items():
        assert four > one, f"c = {reach}: {four:.2f} dB against {one:.2f} dB"


def integral_psnr(scene: Scene) -> dict[int, tuple[float, float]]:
    """Return the PSNR in dB against the exact integral for each c: with interpolation by 4, and with recorded frames
    only.
    """
    centre = 6
    source = [scene.frame(time) for time in range(2 * centre + 1)]
    master = list(interpolate(source, FlowInterpolator(), 4))  # frame k is at time 1 + k / 4
    key = (centre - 1) * 4
    figures = {}
    for reach in REACHES:
        half = (reach + 0.5) / 4  # each of the 2c + 1 master frames covers a quarter of a source interval
        times = centre + np.linspace(-half, half, 401)
        truth = np.mean([scene.picture(time) for time in (times[1:] + times[:-1]) / 2], axis=0)
        four = mean_of_windows(master.__getitem__, key, [reach])[reach]
        one = mean_of_windows(source.__getitem__, centre, [int(half)])[int(half)]
        figures[reach] = tuple(float(10 * np.log10(255**2 / np.mean((made - truth) ** 2))) for made in (four, one))
    return figures


@pytest.mark.parametrize("height", [1, 16, 375, 2160])
def test_the_longest_readout_stays_within_the_frames_around_a_key_frame(height):
    offsets = row_offsets(height, READOUTS[-1])
    assert np.abs(offsets).max() <= REACH
    assert (np.diff(offsets) >= 0).all()

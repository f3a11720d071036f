"""Prove what each shipped corruption leaves of the ground truth by measuring how far it moves content."""

from fractions import Fraction

import numpy as np
import pytest

from robustflow.core.errors import AssetError, UsageError
from robustflow.corruptions import IMAGE_PAIR, load_corruption
from robustflow.corruptions.registry import FURTHER
from robustflow.data.video.clip import write_clip
from robustflow.data.video.codec import i420_to_rgb, lossless, rgb_to_i420
from robustflow.data.video.open_clip import mean_of_windows, rolling_frames
from robustflow.data.video.variants import corrupted_stream
from robustflow.testing.extensions import displacement, distortion
from robustflow.training.request import DataPlan

from .pictures import seen

SHAPE, BORDER = (192, 256), 2
"""Size of the frames, and blocks at their borders where blurs repeat edge pixels."""
SHIFTS = {"glass_blur": 3.2, "camera_motion_blur": 11.5, "far_focus": 0.4}
"""Largest shift that both frames share, in pixels (docs/design/metrics.md)."""
DISTORTIONS = {"psf_blur": 1.4, "glass_blur": 0.6, "far_focus": 0.4, "snow": 0.3}
"""Largest mean deviation from the common shift, in pixels."""
STILL = 0.15
LOSSLESS = lossless("ultrafast")
PAIRS = (*IMAGE_PAIR, *FURTHER["depth"], "raw_noise")


def floor():
    rows = np.arange(SHAPE[0], 0, -1, dtype=np.float32)[:, None].repeat(SHAPE[1], axis=1)
    metres = np.minimum(np.float32(2) * SHAPE[0] / (SHAPE[0] + 1 - rows), np.float32(60))
    return seen(metres, rotation=np.eye(3), translation=np.array([0.1, 0.0, -0.3]), focal=float(SHAPE[1]))


def moved(name, severity):
    """Displacement of both frames' content away from the borders."""
    corruption = load_corruption(name)
    depth = floor() if corruption.needs_depth else None
    inside = slice(BORDER, -BORDER)
    try:
        return [displacement(corruption, severity, SHAPE, index, depth=depth)[inside, inside] for index in (0, 1)]
    except AssetError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("name", PAIRS)
def test_a_corruption_that_leaves_the_truth_unchanged_keeps_content_in_place(name, severity):
    assert load_corruption(name).truth == "unchanged"
    first, second = moved(name, severity)
    assert np.isfinite(first).all()
    assert np.isfinite(second).all()
    assert distortion(first, second) < DISTORTIONS.get(name, STILL)
    for frame in (first, second):
        assert np.hypot(*frame.mean(axis=(0, 1))) < SHIFTS.get(name, 0.3)


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
def test_elastic_transform_moves_content_and_leaves_no_truth(severity):
    first, second = moved("elastic_transform", severity)
    assert load_corruption("elastic_transform").truth == "none"
    assert distortion(first, second) > 4
    np.testing.assert_allclose(first, second, atol=0.2, equal_nan=True)  # one field for the pair


def moving_wave(axis, turn, speed):
    """Return a function that gives the master frame at an index, in which a wave moves along an axis."""
    places = np.indices(SHAPE)[axis]

    def frame_at(index):
        wave = 127.5 + 100 * np.cos(2 * np.pi * (places - speed * index) / 64 + turn)
        return np.rint(wave).astype(np.uint8)[..., None].repeat(3, axis=2)

    return frame_at


def moved_along_x(corrupted, speed=0.5):
    """Displacement of the rows of a corrupted key frame 0 along x, float64 (H,)."""
    read = 0
    for turn in np.pi / 2 * np.arange(4):
        angles = 2 * np.pi * np.arange(SHAPE[1]) / 64 + turn
        read = read + corrupted(moving_wave(1, turn, speed)).mean(axis=2) @ np.exp(-1j * angles)
    return np.angle(read) * 64 / (2 * np.pi)


@pytest.mark.parametrize("reach", load_corruption("object_motion_blur").severities)
def test_object_motion_blur_is_centred_on_its_frame(reach):
    assert load_corruption("object_motion_blur").truth == "unchanged"
    assert np.abs(moved_along_x(lambda at: mean_of_windows(at, 0, [reach])[reach])).max() < 0.02


@pytest.mark.parametrize("readout", load_corruption("rolling_shutter").severities)
def test_rolling_shutter_moves_rows_and_leaves_no_truth(readout):
    assert load_corruption("rolling_shutter").truth == "none"
    rows = moved_along_x(lambda at: rolling_frames(at, 0, [readout])[readout])
    expected = -0.5 * readout * ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0] - 0.5)
    assert np.abs(rows - expected).max() < 0.26  # rows come from the nearest master frame


def test_a_stack_leaves_no_truth_if_one_part_leaves_none():
    assert load_corruption("fog+elastic_transform:2").truth == "none"
    assert load_corruption("fog:1+snow").truth == "unchanged"


def test_training_frames_are_not_corrupted_without_ground_truth():
    assert DataPlan(corruptions=["fog"]).corruption(0).names == ("fog",)
    for name in ("elastic_transform", "fog+elastic_transform:2"):
        with pytest.raises(UsageError):
            DataPlan(corruptions=["fog", name]).corruption(0)


@pytest.mark.parametrize(("name", "most"), [("h264_abr", 0.02), ("h264_crf", 1.0)])
def test_compression_keeps_the_content_of_a_moving_clip_in_place(tmp_path, name, most):
    """Bit errors are not tested: they replace content, and lost frames repeat earlier ones. No dataset with clips has
    ground truth, so their declaration only says that the paper's means include them."""
    assert load_corruption(name).truth == load_corruption("bit_error").truth == "unchanged"
    parameter = load_corruption(name).severities[4] // (16 if name == "h264_abr" else 1)  # for a clip this small
    last = 7

    def corrupted(at):
        pictures = [rgb_to_i420(at(index - last)) for index in range(last + 1)]
        clip = write_clip(tmp_path / f"{len(list(tmp_path.iterdir()))}.mp4", pictures, SHAPE, Fraction(30), LOSSLESS)
        return i420_to_rgb(dict(corrupted_stream(clip, name, parameter).pictures)[last], *SHAPE)

    assert np.abs(moved_along_x(corrupted, speed=3.0)).mean() < most

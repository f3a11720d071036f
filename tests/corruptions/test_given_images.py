"""`corrupt` accepts single images and Pillow images without conversion."""

import numpy as np
import pytest
from PIL import Image

from robustflow.core.errors import DataError, UsageError
from robustflow.corruptions import corrupt, corrupt_clip
from robustflow.corruptions.transform import CorruptionTransform

FRAME = np.random.default_rng(1).integers(0, 256, (40, 56, 3), dtype=np.uint8)


@pytest.mark.parametrize("name", ["snow", "over_exposure"])
def test_a_single_image_is_the_first_frame_of_a_pair(name):
    pair = corrupt(FRAME, FRAME, name, 3, 2, "k")
    assert (corrupt(FRAME, corruption=name, severity=3, seed=2, key="k") == pair[0]).all()


def test_images_of_pillow_come_back_as_such():
    image = Image.fromarray(FRAME)
    first, second = corrupt(image, image, "snow", 3)
    assert isinstance(first, Image.Image)
    assert (first.mode, first.size) == ("RGB", image.size)
    assert (np.asarray(second) == corrupt(FRAME, FRAME, "snow", 3)[1]).all()
    assert isinstance(corrupt(image.convert("L"), corruption="fog", severity=1), Image.Image)


@pytest.mark.parametrize("mode", ["RGBA", "I;16", "F", "CMYK"])
def test_image_with_ambiguous_conversion_is_refused(mode):
    with pytest.raises(DataError, match="convert"):
        corrupt(Image.new(mode, (8, 8)), corruption="fog", severity=1)


def test_a_call_without_a_corruption_or_severity_says_so():
    with pytest.raises(UsageError, match="no corruption"):
        corrupt(FRAME, FRAME)
    with pytest.raises(UsageError, match="no severity specified: give 1"):
        corrupt(FRAME, corruption="fog")


@pytest.mark.parametrize(
    "frame", [(FRAME, FRAME), "a.png", None, FRAME.tolist(), FRAME / 255, FRAME[..., 0], FRAME[:-1]]
)
def test_invalid_frame_is_refused_in_a_pair_and_in_a_clip(frame):
    with pytest.raises(DataError, match=r"frame [12]: "):
        corrupt(frame, FRAME, "fog", 3)
    with pytest.raises(DataError, match="frame 2: "):
        list(corrupt_clip([FRAME, frame, FRAME], "snow", 3))


@pytest.mark.parametrize("integer", [np.int64, np.uint8, np.int32])
def test_integers_of_numpy_give_the_same_bytes(integer):
    expected = corrupt(FRAME, FRAME, "gaussian_noise", 3, seed=5)[0]
    assert (corrupt(FRAME, FRAME, "gaussian_noise", integer(3), seed=integer(5))[0] == expected).all()


@pytest.mark.parametrize("seed", ["5", 5.0, None, True])
def test_a_seed_that_is_no_whole_number_is_refused(seed):
    with pytest.raises(UsageError, match="whole number"):
        corrupt(FRAME, FRAME, "gaussian_noise", 3, seed=seed)


def test_a_frame_without_pixels_is_refused():
    empty = np.zeros((0, 8, 3), np.uint8)
    with pytest.raises(DataError, match=r"expected RGB uint8 \(H, W, 3\), got uint8 \(0, 8, 3\)"):
        corrupt(empty, empty, "fog", 1)


def test_a_scale_that_is_no_text_is_refused():
    with pytest.raises(UsageError, match="unknown severity scale 'None'"):
        corrupt(np.zeros((8, 8, 3), np.uint8), None, "fog", 1, scale=None)


def test_one_severity_for_a_transform_is_refused_with_the_list_to_pass():
    with pytest.raises(UsageError, match=r"severities is a number, 3: pass a list, \[3\]"):
        CorruptionTransform(["fog"], severities=3)

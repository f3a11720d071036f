"""Test the corruption transform: formats, keys, pickling and processes."""

from __future__ import annotations

import multiprocessing
import pickle

import cv2
import numpy as np
import pytest
from PIL import Image

from robustflow.core.errors import DataError, UsageError
from robustflow.core.rng import Rng
from robustflow.corruptions import IMAGE_PAIR, load_corruption
from robustflow.corruptions.scale import calibrated_levels
from robustflow.corruptions.transform import CorruptionTransform

from .pictures import picture

FORMS = {
    "uint8": lambda image: image,
    "float32": lambda image: image.astype(np.float32) / np.float32(255),
    "grey": lambda image: image[..., :1],
    "plane": lambda image: image[..., 0],
    "float plane": lambda image: image[..., 0].astype(np.float32) / np.float32(255),
    "turned": lambda image: image[:, ::-1],
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["gaussian_noise", "spatter", "fog:2+jpeg_compression"])
def test_shape_and_dtype_stay_and_the_input_is_not_touched(name, form):
    image = FORMS[form](picture(40, 56))
    before = image.copy()
    out = CorruptionTransform([name], [5])(image, key="k")
    assert (out.shape, out.dtype) == (image.shape, image.dtype)
    assert out.min() >= 0
    assert out.max() <= (255 if image.dtype == np.uint8 else 1)
    np.testing.assert_array_equal(image, before)
    assert not np.array_equal(out, image)
    assert not np.shares_memory(out, image)


def test_transform_equals_the_corruption_of_that_name_and_severity():
    """The transform gives the same result as the corruption with the random stream described in the module's
    docstring.
    """
    image, corruption = picture(40, 56), load_corruption("fog")
    stream = Rng.of("robustflow transform", 7, "key", "a").spawn("draw")
    expected = corruption.apply(image, corruption.draw(stream, 2, image.shape[:2]), 0)
    np.testing.assert_array_equal(CorruptionTransform(["fog"], [2], seed=7)(image, key="a"), expected)


def test_float_image_is_corrupted_like_the_8_bit_image():
    image = picture(40, 56)
    transform = CorruptionTransform(["gaussian_noise"], [3])
    between = np.clip(image + np.random.default_rng(0).uniform(-0.4, 0.4, image.shape), 0, 255)
    out = transform((between / 255).astype(np.float32), key=1)
    np.testing.assert_array_equal(np.rint(out * 255).astype(np.uint8), transform(image, key=1))


def test_frames_of_a_clip_share_the_parameters_that_a_pair_shares():
    frames = [picture(40, 56, seed=index) for index in range(3)]
    transform = CorruptionTransform(["frost"], [4])
    clip = transform(frames, key="clip")
    for one, index in zip(clip, range(3), strict=True):
        np.testing.assert_array_equal(one, transform(frames[index], key="clip"))
    noise = CorruptionTransform(["gaussian_noise"], [4])
    flat = np.full((32, 32, 3), 128, np.uint8)
    first, second = noise((flat, flat), key="clip")
    assert not np.array_equal(first, second)
    assert isinstance(noise((flat, flat)), tuple)
    stacked = noise(np.stack([flat, flat]), key="clip")
    np.testing.assert_array_equal(stacked, np.stack([first, second]))


def test_grey_images_get_full_noise_or_the_luma_of_colour_corruptions():
    flat = np.full((200, 200), 128, np.uint8)
    for name in ("gaussian_noise", "pixelate+gaussian_noise"):
        noisy = CorruptionTransform([name], [1])(flat, key=0).astype(float)
        assert noisy.std() == pytest.approx(0.08 * 255, rel=0.03)
    grey = picture(64, 64)[..., :1]
    colour = np.repeat(grey, 3, axis=2)
    for name in ("spatter", "fog+spatter"):
        transform = CorruptionTransform([name], [5])
        expected = cv2.cvtColor(transform(colour, key=1), cv2.COLOR_RGB2GRAY)
        np.testing.assert_array_equal(transform(grey, key=1)[..., 0], expected)


@pytest.mark.parametrize("name", [name for name in IMAGE_PAIR if "noise" not in name])
def test_grey_image_is_corrupted_to_the_luma_of_the_rgb_result(name):
    """The grey result is the luma of the RGB result, whose channels may be equal."""
    grey = picture(48, 48)[..., :1]
    transform = CorruptionTransform([name], [3])
    colour = transform(np.repeat(grey, 3, axis=2), key=0)
    luma = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY).astype(int)
    assert np.abs(transform(grey, key=0)[..., 0] - luma).max() <= 1


def test_draws_depend_on_the_key_or_on_the_number_of_the_call():
    transform = CorruptionTransform(["impulse_noise"], [3], seed=1)
    image = picture(40, 56)
    again = CorruptionTransform(["impulse_noise"], [3], seed=1)
    firsts = [transform(image) for _ in range(3)]
    seconds = [again(image) for _ in range(3)]
    np.testing.assert_array_equal(firsts, seconds)
    assert len({out.tobytes() for out in firsts}) == 3
    np.testing.assert_array_equal(transform(image, key="x"), again(image, key="x"))
    assert (transform(image, key="x") != transform(image, key="y")).any()
    assert (CorruptionTransform(["impulse_noise"], [3], seed=2)(image, key="x") != again(image, key="x")).any()


def test_names_severities_and_probability_are_drawn_as_requested():
    image = np.full((16, 16, 3), 100, np.uint8)
    transform = CorruptionTransform(["high_light", "low_light"], [1, 2], probability=0.5)
    seen = [int(transform(image, key=key)[0, 0, 0]) for key in range(400)]
    counts = {value: seen.count(value) for value in set(seen)}
    assert set(counts) == {100, 126, 151, 74, 49}
    assert 160 <= counts.pop(100) <= 240
    assert all(25 <= count <= 75 for count in counts.values())


class Dim:
    """Subtracts the severity."""

    def draw(self, rng, severity, shape):
        return severity

    def apply(self, frame, state, index):
        return frame - np.uint8(state)


@pytest.mark.parametrize("made", [Dim, Dim()])
def test_a_custom_corruption_is_a_class_or_an_object(made):
    transform = CorruptionTransform([made, "contrast"], [3])
    assert transform.names == ("dim", "contrast")
    flat = np.full((8, 8, 3), 100, np.uint8)
    assert {int(transform(flat, key=key)[0, 0, 0]) for key in range(20)} == {97, 100}


def test_transform_draws_only_severities_of_the_scale():
    name = next(name for name in IMAGE_PAIR if 0 < len(calibrated_levels(name)) < 5)
    known = calibrated_levels(name)
    lacking = [level for level in range(1, 6) if level not in known]
    CorruptionTransform([name], scale="calibrated")(picture(40, 56), key=0)
    with pytest.raises(UsageError, match="calibrated scale"):
        CorruptionTransform([name], lacking, scale="calibrated")


def test_a_pickled_copy_continues_where_the_original_stood():
    transform, image = CorruptionTransform(["shot_noise"], [2]), picture(40, 56)
    transform(image)
    copy = pickle.loads(pickle.dumps(transform))
    np.testing.assert_array_equal(copy(image), transform(image))


def _send_two(transform, pipe):
    flat = np.full((16, 16, 3), 128, np.uint8)
    pipe.send([transform(flat).tobytes() for _ in range(2)])


def test_processes_with_copies_of_one_transform_have_different_draws():
    transform = CorruptionTransform(["gaussian_noise"], [3])
    context = multiprocessing.get_context("fork")
    drawn = []
    for _ in range(2):
        ours, child = context.Pipe()
        process = context.Process(target=_send_two, args=(transform, child))
        process.start()
        drawn += ours.recv()
        process.join()
    flat = np.full((16, 16, 3), 128, np.uint8)
    assert len({*drawn, transform(flat).tobytes()}) == 5


def test_ranks_of_a_distributed_training_have_different_draws(monkeypatch):
    flat, drawn = np.full((16, 16, 3), 128, np.uint8), []
    for rank in ("0", "1"):
        monkeypatch.setenv("RANK", rank)
        transform = CorruptionTransform(["gaussian_noise"], [3])
        drawn.append((transform(flat).tobytes(), transform(flat, key="a").tobytes()))
    assert drawn[0][0] != drawn[1][0]
    assert drawn[0][1] == drawn[1][1]


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (np.zeros((20, 20, 3), np.uint16), "convert it to uint8"),
        (np.zeros((20, 20, 3), np.float64), "float32"),
        (np.full((20, 20, 3), np.nan, np.float32), "NaN"),
        (np.full((20, 20, 3), 1.01, np.float32), "1.01"),
        (np.full((20, 20, 3), -0.1, np.float32), "-0.1"),
        (np.zeros((20, 20, 4), np.uint8), r"\(20, 20, 4\)"),
        (np.zeros((0, 20, 3), np.uint8), "shape"),
        ([np.zeros((20, 20, 3), np.uint8), np.zeros((20, 21, 3), np.uint8)], "differ"),
        ([], "no image"),
        ("image.png", "numpy"),
        (None, "numpy"),
        (Image.new("RGB", (20, 20)), "numpy"),
    ],
)
def test_image_of_unsupported_shape_or_dtype_is_refused(image, says):
    with pytest.raises(DataError, match=says):
        CorruptionTransform(["contrast"])(image)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"names": ["fogg"]}, "did you mean 'fog'"),
        ({"names": "fog"}, "list"),
        ({"names": []}, "nothing"),
        ({"names": ["fog+h264_crf"]}, "entire clip"),
        ({"names": ["fog_3d"]}, "requires depth"),
        ({"names": ["snow+fog_3d:2"]}, "requires depth"),
        ({"severities": [0]}, "severity 0"),
        ({"severities": []}, "nothing"),
        ({"probability": 1.5}, "probability"),
        ({"probability": float("nan")}, "probability"),
        ({"seed": "1"}, "whole number"),
    ],
)
def test_impossible_arguments_of_the_transform_are_refused(arguments, says):
    with pytest.raises(UsageError, match=says):
        CorruptionTransform(**arguments)


def test_psf_blur_is_not_a_default():
    assert set(IMAGE_PAIR) - set(CorruptionTransform().names) == {"psf_blur"}
    assert CorruptionTransform(["psf_blur"]).names == ("psf_blur",)


def test_repr_shows_only_arguments_that_differ_from_the_defaults():
    assert repr(CorruptionTransform(probability=0.5)) == (
        "CorruptionTransform(names=the default, severities=[1, 2, 3, 4, 5], probability=0.5, seed=0)"
    )
    assert repr(CorruptionTransform(["fog"], variant="reference")).endswith("seed=0, variant='reference')")

"""`corrupt`: images, channel order, clips around a pair, stacks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from skimage import data

from robustflow.core.errors import AssetError, DataError
from robustflow.corruptions import IMAGE_PAIR, corrupt, corrupt_clip, load_corruption
from robustflow.corruptions.api import stream_for
from robustflow.corruptions.condition import condition_of
from robustflow.corruptions.corruption import VARIANTS
from robustflow.corruptions.registry import CLIP, CORRUPTIONS, FURTHER

from ..refusals import refusal
from .pictures import picture

FRAME = np.random.default_rng(1).integers(0, 256, (40, 56, 3), dtype=np.uint8)


def test_images_of_pillow_come_back_as_such():
    image = Image.fromarray(FRAME)
    first, second = corrupt(image, image, "snow", 3)
    assert isinstance(first, Image.Image)
    assert (first.mode, first.size) == ("RGB", image.size)
    assert (np.asarray(second) == corrupt(FRAME, FRAME, "snow", 3)[1]).all()
    assert isinstance(corrupt(image.convert("L"), corruption="fog", severity=1), Image.Image)


@pytest.mark.parametrize(
    "frame", [(FRAME, FRAME), "a.png", None, FRAME.tolist(), FRAME / 255, FRAME[..., 0], FRAME[:-1], FRAME[:0]]
)
def test_invalid_frame_is_refused_in_a_pair_and_in_a_clip(frame):
    with pytest.raises(DataError) as caught:
        corrupt(frame, FRAME, "fog", 3)
    assert caught.value.culprit in ("frame 1", "frame 2")
    refusal(lambda: list(corrupt_clip([FRAME, frame, FRAME], "snow", 3)), DataError, "frame 2")


@pytest.mark.parametrize("integer", [np.int64, np.uint8, np.int32])
def test_integers_of_numpy_give_the_same_bytes(integer):
    expected = corrupt(FRAME, FRAME, "gaussian_noise", 3, seed=5)[0]
    assert (corrupt(FRAME, FRAME, "gaussian_noise", integer(3), seed=integer(5))[0] == expected).all()


@pytest.mark.parametrize("name", IMAGE_PAIR)
def test_bgr_variant_equals_the_reference_on_reversed_channels(name):
    turned = np.ascontiguousarray(FRAME[..., ::-1])
    bgr = corrupt(FRAME, FRAME, name, 1, 1, "k", variant="reference-bgr")
    reference = corrupt(turned, turned, name, 1, 1, "k", variant="reference")
    assert all((a == b[..., ::-1]).all() for a, b in zip(bgr, reference, strict=True))


FLAT = [name for name in CORRUPTIONS.names() if name not in (*CLIP, *FURTHER["depth"])]
NAMES = [*FLAT, "fog:2+gaussian_noise", "snow+over_exposure:3"]
NEW_IN_EVERY_FRAME = {"snow", "gaussian_noise", "shot_noise", "impulse_noise", "raw_noise"}
EVERY_SECOND_FRAME = {"over_exposure", "under_exposure"}


def window(frames, name, severity, **options):
    """Return the corrupted frames; skip the test if textures or lenses are missing and cannot be downloaded."""
    try:
        return list(corrupt_clip(frames, name, severity, **options))
    except AssetError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=6)
@given(
    before=st.integers(0, 4),
    after=st.integers(0, 3),
    size=st.tuples(st.integers(16, 60), st.integers(16, 60)),
    severity=st.integers(1, 5),
    variant=st.sampled_from(VARIANTS),
    seed=st.integers(0, 2**32),
)
def test_pair_in_a_window_equals_the_pair_alone(name, before, after, size, severity, variant, seed):
    frames = [picture(*size, seed=i) for i in range(before + 2 + after)]
    options = {"seed": seed, "key": "k", "variant": variant}
    clip = window(frames, name, severity, first=-before, **options)
    pair = corrupt(frames[before], frames[before + 1], name, severity, **options)
    assert len(clip) == len(frames)
    assert (clip[before] == pair[0]).all()
    assert (clip[before + 1] == pair[1]).all()
    if before:
        shorter = window(frames[1:], name, severity, first=1 - before, **options)
        assert all((a == b).all() for a, b in zip(clip[1:], shorter, strict=True)), "a frame depends on the window"


@pytest.mark.parametrize("name", FLAT)
def test_window_has_as_many_different_frames_as_the_corruption_changes_in_time(name):
    frame = picture(48, 64)
    distinct = {out.tobytes() for out in window([frame] * 9, name, 3, first=-5)}
    expected = 9 if name in NEW_IN_EVERY_FRAME else 2 if name in EVERY_SECOND_FRAME else 1
    assert len(distinct) == expected


@pytest.mark.parametrize("name", sorted(EVERY_SECOND_FRAME))
@pytest.mark.parametrize("seed", range(4))
def test_exposure_alternates_across_the_pair(name, seed):
    frame = picture(16, 16)
    changed = [bool((out != frame).any()) for out in window([frame] * 8, name, 4, first=-4, seed=seed)]
    assert changed == [changed[0], not changed[0]] * 4


ASTRONAUT = np.ascontiguousarray(data.astronaut()[:96, :128])


def test_parts_are_applied_in_order():
    stack = load_corruption("contrast:5+impulse_noise:1")
    first, _ = corrupt(ASTRONAUT, ASTRONAUT, stack, 3)
    contrast = load_corruption("contrast")
    low = contrast.apply(ASTRONAUT, contrast.draw(stream_for(contrast, 5, 0, ""), 5, ASTRONAUT.shape[:2]), 0)
    untouched = (first == low).mean()
    assert 0.95 < untouched < 0.98, "impulses of severity 1 (3 % of the samples) are on top of the low-contrast image"
    other, _ = corrupt(ASTRONAUT, ASTRONAUT, "impulse_noise:1+contrast:5", 3)
    assert other.std() < first.std() / 2, "if contrast is applied last, it also affects the impulses"


def test_same_corruption_twice_draws_twice():
    stack = load_corruption("gaussian_noise+gaussian_noise")
    states = stack.draw(stream_for(stack, 2, 0, "key"), 2, ASTRONAUT.shape[:2])
    noise = load_corruption("gaussian_noise")
    grey = np.full((64, 64, 3), 128, np.uint8)
    once, again = (noise.apply(grey, state, 0).astype(float) for state in states)
    assert abs(np.corrcoef(once.ravel(), again.ravel())[0, 1]) < 0.05


def test_severity_of_the_stack_reaches_parts_without_their_own():
    mild, _ = corrupt(ASTRONAUT, ASTRONAUT, "contrast+jpeg_compression", 1)
    severe, _ = corrupt(ASTRONAUT, ASTRONAUT, "contrast+jpeg_compression", 5)
    assert severe.std() < mild.std()
    assert condition_of("contrast+jpeg_compression").levels((1, 5)) == (1, 5)
    assert condition_of("contrast:2+jpeg_compression:3").levels((1, 5)) == (3,)

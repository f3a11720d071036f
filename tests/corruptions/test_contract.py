"""Test the requirements for every registered pair corruption on frames of many sizes."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import AssetError, UsageError
from robustflow.core.rng import Rng
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.base import VARIANTS
from robustflow.corruptions.registry import CLIP, CORRUPTIONS, FURTHER, IMAGE_PAIR, PAPER_ORDER

from .pictures import picture, scene

NAMES = [name for name in CORRUPTIONS.names() if name not in CLIP]
every_corruption = pytest.mark.parametrize("name", NAMES)


def corrupted(*args, **options):
    """Call `corrupt` with depth; skip the test if textures or lenses are missing and cannot be downloaded."""
    try:
        return corrupt(*args, **options, depth=scene(*args[0].shape[:2]))
    except AssetError as error:
        pytest.skip(str(error))


@every_corruption
@settings(max_examples=8)
@given(
    size=st.tuples(st.integers(1, 90), st.integers(1, 90)),
    severity=st.integers(1, 5),
    variant=st.sampled_from(VARIANTS),
    seed=st.integers(0, 2**32),
    value=st.sampled_from([0, 255]),
)
def test_every_corruption_keeps_the_contract(name, size, severity, variant, seed, value):
    frames = [picture(*size, seed=0), picture(*size, seed=1), np.full((*size, 3), value, np.uint8)]
    untouched = [frame.copy() for frame in frames]
    options = {"seed": seed, "key": "k", "variant": variant}
    pair, other_second = (corrupted(frames[0], frame, name, severity, **options) for frame in frames[1:])
    for out in (*pair, *other_second):
        assert out.shape == (*size, 3)
        assert out.dtype == np.uint8
        assert out.flags.c_contiguous
        assert not any(np.shares_memory(out, frame) for frame in frames)
    assert all((frame == before).all() for frame, before in zip(frames, untouched, strict=True))

    again = corrupted(frames[0], frames[1], name, severity, **options)
    assert all((out == other).all() for out, other in zip(pair, again, strict=True)), "different bytes for the same key"

    assert (other_second[0] == pair[0]).all(), "frame 1 depends on frame 2"


@every_corruption
def test_views_and_read_only_frames_are_accepted(name):
    whole = picture(70, 101)
    strided, reverse = whole[1:61:2, 3:99:3], picture(40, 50)[::-1, ::-1, ::-1]
    read_only = picture(40, 50, seed=1)
    read_only.setflags(write=False)
    fortran = np.asfortranarray(picture(33, 47))
    for frame in (strided, reverse, read_only, fortran):
        expected = corrupted(frame.copy(order="C"), frame.copy(order="C"), name, 3)
        found = corrupted(frame, frame, name, 3)
        assert all((out == other).all() for out, other in zip(found, expected, strict=True))


@pytest.mark.parametrize("name", FURTHER["depth"])
def test_layout_of_depth_maps_changes_no_byte(name):
    frame, depth = picture(60, 90), scene(60, 90)
    wide = np.zeros((60, 180), np.float32)
    wide[:, ::2] = depth.maps[1]
    turned = replace(depth, maps=(np.asfortranarray(depth.maps[0]), wide[:, ::2]))
    assert np.array_equal(corrupt(frame, frame, name, 4, depth=turned), corrupt(frame, frame, name, 4, depth=depth))


class _NotToBeUsed:
    """Replaces a random generator; any use of it is an error."""

    def __getattribute__(self, name):
        raise AssertionError(f"the generator is used: {name}")


def draws_nothing(name):
    """Return whether a corruption is independent of key and seed because it never uses the random generator."""
    corruption = load_corruption(name)
    try:
        state = corruption.draw_with_depth(_NotToBeUsed(), 3, (64, 80), scene(64, 80))
        corruption.apply(picture(64, 80), state, 1)
    except AssertionError:
        return False
    return True


def test_only_deterministic_corruptions_draw_nothing():
    """Among the pair corruptions, only these have no random parameters."""
    fixed = {name for name in IMAGE_PAIR if draws_nothing(name)}
    assert fixed == {
        "jpeg_compression", "pixelate", "contrast", "saturate", "high_light", "low_light", "gaussian_blur",
        "defocus_blur", "psf_blur",
    }  # fmt: skip


@every_corruption
def test_keys_seeds_and_severities_change_what_is_drawn(name):
    frame = picture(64, 80)
    if draws_nothing(name):
        distinct = {corrupted(frame, frame, name, 3, seed=seed)[1].tobytes() for seed in range(4)}
        assert len(distinct) == 1
        return
    keys = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, 3, key=str(key))) for key in range(12)}
    seeds = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, 3, seed=seed)) for seed in range(12)}
    # there are only two choices for the exposed frame, and similar blur directions may coincide
    least = 2 if name.endswith("exposure") else 9
    assert len(keys) >= least
    assert len(seeds) >= least


@every_corruption
def test_severities_of_a_corruption_give_different_frames(name):
    frame = picture(96, 128)
    outputs = {b"".join(out.tobytes() for out in corrupted(frame, frame, name, level)) for level in range(1, 6)}
    assert len(outputs) == 5


@every_corruption
def test_a_pickled_state_gives_the_same_frames_in_any_order(name):
    frame, corruption = picture(40, 50), load_corruption(name)
    state = corruption.draw_with_depth(Rng.of("contract", name), 4, frame.shape[:2], scene(*frame.shape[:2]))
    try:
        out = [corruption.apply(frame, state, index) for index in (0, 1)]
    except AssetError as error:
        pytest.skip(str(error))
    again = pickle.loads(pickle.dumps(state))
    assert np.array_equal([corruption.apply(frame, again, index) for index in (1, 0)], out[::-1])


@pytest.mark.parametrize("severity", [0, 6, -1, True])
def test_severities_that_do_not_exist_are_refused(severity):
    frame = picture(32, 32)
    with pytest.raises(UsageError, match="severity"):
        corrupt(frame, frame, "fog", severity)


@every_corruption
def test_threads_share_an_instance(name):
    corruption, frames = load_corruption(name), [picture(60, 75, seed=i) for i in range(6)]
    expected = [corrupted(frame, frame, corruption, 2, key=str(i)) for i, frame in enumerate(frames)]
    with ThreadPoolExecutor(3) as pool:
        jobs = [pool.submit(corrupted, frame, frame, corruption, 2, key=str(i)) for i, frame in enumerate(frames)]
        for job, pair in zip(jobs, expected, strict=True):
            assert all((out == other).all() for out, other in zip(job.result(), pair, strict=True))


@pytest.mark.slow
@every_corruption
@pytest.mark.parametrize("size", [(2160, 4096), (1999, 61), (17, 3001)])
def test_large_and_elongated_frames_are_corrupted(name, size):
    frame = picture(*size)
    for out in corrupted(frame, frame, name, 5):
        assert out.shape == frame.shape
        assert out.dtype == np.uint8


def test_every_name_of_the_paper_is_registered():
    assert set(PAPER_ORDER) <= set(CORRUPTIONS.names())
    for name in NAMES:
        corruption = load_corruption(name)
        assert len(corruption.severities) == 5
        assert corruption.__doc__, f"{name} has no description"


def test_the_paper_has_eight_temporal_corruptions():
    """The temporal corruptions in section 3 of the paper: exposure, snow, the two motion blurs and the three video
    corruptions.
    """
    temporal = [name for name in PAPER_ORDER if load_corruption(name).temporal]
    assert temporal == [
        "over_exposure", "under_exposure", "snow", "camera_motion_blur", "object_motion_blur",
        "h264_crf", "h264_abr", "bit_error",
    ]  # fmt: skip


def test_a_class_has_the_name_of_its_corruption():
    for name in CORRUPTIONS.names():
        kind = CORRUPTIONS.get(name)
        assert kind.name == name
        assert kind.__name__ == "".join(word.capitalize() for word in name.split("_"))


def test_parameters_have_names_where_there_are_several():
    for name in CORRUPTIONS.names():
        for scale in ("paper", "calibrated"):
            for value in load_corruption(name, scale=scale).severities:
                assert not isinstance(value, tuple) or value._fields, name

"""Test clips that contain a pair: a single draw, the same bytes for the pair, and the frames that precede it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import AssetError, UsageError
from robustflow.corruptions import corrupt, corrupt_clip
from robustflow.corruptions.base import VARIANTS
from robustflow.corruptions.registry import CLIP, CORRUPTIONS, FURTHER

from .pictures import picture, scene

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


@pytest.mark.parametrize("name", [*FURTHER["depth"], "fog+fog_3d:2"])
@pytest.mark.parametrize("first", [-1, 0])
def test_frames_around_a_pair_have_no_depth_and_are_refused(name, first):
    frames = [picture(32, 48, seed=i) for i in range(3)]
    with pytest.raises(UsageError, match="use pairs and a model with two input frames"):
        list(corrupt_clip(frames, name, 2, first=first, depth=scene(32, 48)))

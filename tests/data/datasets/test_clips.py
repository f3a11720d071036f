"""Test the frames around a pair for every dataset that provides them."""

import pickle

import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.base import Clips, CorruptedClips, has_clips
from robustflow.media.images import read_image
from tests.data.video import clips

from .layouts import HEIGHT, flow, kitti, picture, sintel, spring


def check(dataset, key, files, place):
    """Assert that the dataset's frames around the pair at index `place` of a sequence are those of
    `files`, in order.
    """
    assert isinstance(dataset, Clips)
    assert has_clips(dataset)
    before, after = place, len(files) - place - 2
    assert dataset.around(key, 100) == range(-before, after + 2)
    assert dataset.around(key, 1) == range(-min(before, 1), 2 + min(after, 1))
    for offset in dataset.around(key, 100):
        assert dataset.frame_files(key, [offset]) == [files[place + offset]]
        assert (dataset.frame(key, offset) == read_image(files[place + offset])).all()
    assert dataset.frame_files(key, [1, -before, 0, 1]) == list(dict.fromkeys([files[0], *files[place : place + 2]]))
    pair = dataset.load(key).frames
    assert (pair[0] == dataset.frame(key, 0)).all()
    assert (pair[1] == dataset.frame(key, 1)).all()
    assert pickle.loads(pickle.dumps(dataset)).around(key, 100) == dataset.around(key, 100)


@pytest.mark.parametrize("place", range(4))
def test_sintel_gives_the_frames_around_a_pair(tmp_path, place):
    folder = sintel(tmp_path, frames=5)
    files = [folder / f"clean/alley_1/frame_{number:04d}.png" for number in range(1, 6)]
    check(load_dataset("sintel", tmp_path), f"alley_1/frame_{place + 1:04d}", files, place)


@pytest.mark.parametrize("direction", ["FW", "BW"])
def test_spring_gives_the_frames_around_a_pair_in_both_directions(tmp_path, direction):
    pytest.importorskip("h5py", reason="needs the h5 extra")
    train = spring(tmp_path, frames=4)
    numbers = (1, 2, 3, 4) if direction == "FW" else (4, 3, 2, 1)
    files = [train / f"0001/frame_left/frame_left_{number:04d}.png" for number in numbers]
    check(load_dataset("spring", tmp_path, direction=direction), f"0001/{numbers[1]:04d}", files, 1)


def test_kitti_with_its_multi_view_extension_gives_the_frames_around_a_pair(tmp_path):
    folder = tmp_path / "training"
    kitti(folder, ["000003", "000007"])
    for pairs_alone in (load_dataset("kitti2015", tmp_path), load_dataset("motorcycle")):
        assert not has_clips(pairs_alone)
        assert not isinstance(pairs_alone, CorruptedClips)
    for number in (0, 7, 8, 9, 12, 13):
        picture(folder / "image_2" / f"000003_{number:02d}.png")
    dataset = load_dataset("kitti2015", tmp_path)
    assert dataset.keys() == ["000003", "000007"], "frames of the extension begin no pairs"
    files = [folder / "image_2" / f"000003_{number:02d}.png" for number in range(7, 14)]
    check(dataset, "000003", files, 3)
    assert dataset.around("000007", 5) == range(2)


def test_middlebury_with_eight_frames_gives_those_around_a_pair(tmp_path):
    for scene, numbers in (("Army", range(7, 15)), ("Venus", (10, 11))):
        for number in numbers:
            picture(tmp_path / "other-data" / scene / f"frame{number:02d}.png")
        flow(tmp_path / "other-gt-flow" / scene / "flow10.flo")
    dataset = load_dataset("middlebury", tmp_path)
    check(dataset, "Army", [tmp_path / f"other-data/Army/frame{number:02d}.png" for number in range(7, 15)], 3)
    assert dataset.around("Venus", 5) == range(2)


@pytest.mark.parametrize("step", [1, 2])
def test_folder_gives_the_frames_around_a_pair_in_steps(tmp_path, step):
    for number in range(1, 12):
        picture(tmp_path / "walk" / f"{number}.png")
    for number in range(1, 4):
        picture(tmp_path / "still" / f"{number}.png")
    files = [tmp_path / "walk" / f"{number}.png" for number in range(1, 12, step)]
    check(load_dataset("folder", tmp_path, step=step), f"walk/{1 + 2 * step}", files, 2)


@pytest.mark.parametrize("step", [1, 3])
def test_video_gives_the_frames_around_a_pair_in_any_order(tmp_path, step):
    clips.clip(tmp_path / "walk.mp4", 12, fps=25)
    dataset = load_dataset("folder", tmp_path / "walk.mp4", step=step)
    every = load_dataset("folder", tmp_path / "walk.mp4")
    frames = [every.load(f"{index:06d}").frames[0] for index in range(11)] + [every.load("000010").frames[1]]
    keys = dataset.keys()
    for key in [*keys, *reversed(keys)]:
        index = int(key)
        there = dataset.around(key, 2)
        assert there.start == -min(2, index // step)
        assert there.stop == min(3, (11 - index) // step) + 1
        for offset in there:
            np.testing.assert_array_equal(dataset.frame(key, offset), frames[index + offset * step])
    assert dataset.frame_files("000000", [0, 1]) == [tmp_path / "walk.mp4"]


def test_frame_of_a_different_size_is_refused_by_its_path(tmp_path):
    for number in (9, 10, 11):
        picture(tmp_path / f"other-data/Army/frame{number:02d}.png", height=HEIGHT + (number == 9))
    flow(tmp_path / "other-gt-flow/Army/flow10.flo")
    with pytest.raises(DataError, match=r"frame10.png is 6x8, .*frame09.png is 7x8"):
        load_dataset("middlebury", tmp_path).frame("Army", -1)


def test_real_video_gives_the_frames_around_a_pair(shared):
    """The frames around a pair are the key frames of the neighbouring pairs, backwards and forwards."""
    for path in sorted(shared("data", "video").glob("*.m*"))[:2]:
        dataset = load_dataset("folder", path)
        keys = dataset.keys()
        for place in (len(keys) - 2, 2):
            for offset in (2, -1, -2):
                if 0 <= place + offset < len(keys):
                    shown = dataset.load(keys[place + offset]).frames[0]
                    np.testing.assert_array_equal(dataset.frame(keys[place], offset), shown)

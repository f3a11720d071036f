"""Test the pairs of KITTI's multi-view extension and raw data, and the messages for a wrong folder."""

from __future__ import annotations

import csv
from importlib.resources import files
from pathlib import Path

import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import load_dataset
from robustflow.data.datasets.split import KITTI_KEYS, kitti_split

from .layouts import picture


@pytest.fixture
def multiview(tmp_path) -> Path:
    for part in ("training", "testing"):
        for camera in ("image_2", "image_3"):
            for scene in range(2):
                for frame in range(21):
                    picture(tmp_path / part / camera / f"{scene:06d}_{frame:02d}.png")
    return tmp_path


@pytest.fixture
def raw(tmp_path) -> Path:
    # drive 0009 contains pairs of KITTI 2015
    for drive in ("2011_09_26_drive_0009_sync", "2011_09_26_drive_0099_sync"):
        for camera in ("image_02", "image_03"):
            for frame in (0, 1, 2, 4, 5):  # frame 3 is missing, as happens in some drives
                picture(tmp_path / "2011_09_26" / drive / camera / "data" / f"{frame:010d}.png")
    return tmp_path


def test_a_scene_gives_15_pairs_of_a_camera(multiview):
    for options, scenes in (
        ({"part": "training", "camera": "both"}, 4),  # ARFlow uses both cameras of the training scenes
        ({"part": "all", "camera": "left"}, 4),  # UPFlow uses the left camera of all scenes
        ({}, 8),
    ):
        dataset = load_dataset("kitti_multiview", multiview, **options)
        keys = dataset.keys()
        assert len(keys) == 15 * scenes
    for key in keys:
        first, second = (int(path.stem[-2:]) for path in dataset.files(key))
        assert second == first + 1
        assert not {first, second} & {9, 10, 11, 12}
    assert dataset.load("testing/image_3/000001_13").flow is None


def test_pairs_of_a_neighbouring_scene_contain_an_evaluated_pair(multiview):
    """The drives' table records pairs 000007 and 000008 of KITTI 2015 ten frames apart, so the first pair of scene
    000008 is the evaluated pair of scene 000007; 17 evaluated pairs of the default split are such pairs.
    """
    table = files("robustflow.data.datasets") / "data" / "kitti2015_drives.csv"
    lines = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    frame_of = {line["pair"]: (line["drive"], int(line["frame"])) for line in lines}
    trained = {
        (drive, frame - 10 + int(key[-2:])) for drive, frame in frame_of.values() for key in _keys_of_scene(multiview)
    }
    evaluated = kitti_split(KITTI_KEYS).evaluation
    assert sum(frame_of.get(pair) in trained for pair in evaluated) == 17
    assert not getattr(load_dataset("kitti_multiview", multiview), "leaves_out_evaluated", False)


def _keys_of_scene(root):
    keys = load_dataset("kitti_multiview", root, part="training", camera="left").keys()
    return [key for key in keys if "000000_" in key]


def test_folder_with_only_the_pairs_is_read(tmp_path):
    for frame in (10, 11):
        picture(tmp_path / "training" / "image_2" / f"000000_{frame}.png")
    with pytest.raises(DataError, match=r"no pair of frames"):
        load_dataset("kitti_multiview", tmp_path, part="training", camera="left")
    with pytest.raises(DataError, match=r"training/image_3: no such folder"):
        load_dataset("kitti_multiview", tmp_path, part="training", camera="both")
    with pytest.raises(DataError, match="not laid out"):
        load_dataset("kitti_multiview", tmp_path, part="testing", camera="left")
    with pytest.raises(UsageError, match="camera 'middle' does not exist"):
        load_dataset("kitti_multiview", tmp_path, camera="middle")


def test_drives_of_evaluated_pairs_are_left_out(raw):
    dataset = load_dataset("kitti_raw", raw)
    assert dataset.keys() == [f"2011_09_26_drive_0099_sync/image_02/{frame:010d}" for frame in (0, 1, 4)]
    assert dataset.leaves_out_evaluated
    every = load_dataset("kitti_raw", raw, drives="all", camera="both")
    assert len(every.keys()) == 12
    assert not every.leaves_out_evaluated
    assert load_dataset("kitti_raw", raw / "2011_09_26").keys() == dataset.keys()  # one day is enough


def test_list_of_pairs_selects_the_pairs(raw, tmp_path):
    names = [f"2011_09_26/2011_09_26_drive_0009_sync/image_02/data/{frame:010d}.png" for frame in (0, 2)]
    (tmp_path / "pairs.txt").write_text(" ".join(names) + "\n")
    dataset = load_dataset("kitti_raw", raw, listing=str(tmp_path / "pairs.txt"))
    (key,) = dataset.keys()
    assert [path.name for path in dataset.files(key)] == ["0000000000.png", "0000000002.png"]
    for text, match in ((names[0], "line 1: only one name"), ((" ".join(names) + "\n") * 2, "line 2: begins with")):
        (tmp_path / "pairs.txt").write_text(text)
        with pytest.raises(DataError, match=match):
            load_dataset("kitti_raw", raw, listing=str(tmp_path / "pairs.txt"))


def test_folder_of_a_different_layout_is_refused(tmp_path):
    with pytest.raises(DataError, match="not laid out like KITTI raw"):
        load_dataset("kitti_raw", tmp_path)
    with pytest.raises(DataError, match="no such folder"):
        load_dataset("kitti_raw", tmp_path / "nowhere")

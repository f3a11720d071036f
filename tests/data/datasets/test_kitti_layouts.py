"""Readers of KITTI and KITTI-FC find the files that belong together in small folders, and reject invalid input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import PreCorrupted, load_dataset
from robustflow.media.images import read_image

from .layouts import HEIGHT, WIDTH, check, flow, kitti, picture, refused


@pytest.mark.parametrize("name", ["kitti2015", "kitti2012"])
@pytest.mark.parametrize("images", ["image_2", "image_0", "colored_0"])
def test_kitti_folder_gives_its_pairs_and_ground_truth(tmp_path: Path, name: str, images: str) -> None:
    folder = tmp_path / "training"
    kitti(folder, ["000010", "000002"], images)
    picture(folder / images / "000010_09.png")  # the multi-view extension has more frames
    if (name == "kitti2015") != (images == "image_2"):
        refused(name, tmp_path, "not laid out like KITTI")
        return
    for root in (tmp_path, folder):
        dataset = load_dataset(name, root)
        assert dataset.keys() == ["000002", "000010"]
        shots = [folder / images / f"000010_{number}.png" for number in (10, 11)]
        check(dataset, "000010", *shots, folder / "flow_occ" / "000010_10.png")
        sample = dataset.load("000010")
        assert sample.occluded[:-1, 0].all()
        assert not sample.occluded[:, 1:].any()
        assert not sample.occluded[~sample.valid].any()
        assert sample.meta == {"ground_truth": "occ"}
        assert sample.group == {"kitti2015": "2011_09_26_drive_0009", "kitti2012": "2011_09_30_drive_0033"}[name]


def test_kitti_with_only_occ_or_noc_maps_is_read(tmp_path: Path) -> None:
    kitti(tmp_path / "noc", ["000000"], occ=False)
    kitti(tmp_path / "occ", ["000000"], noc=False)
    noc, occ = (load_dataset("kitti2015", tmp_path / kind).load("000000") for kind in ("noc", "occ"))
    assert noc.occluded is None
    assert noc.meta == {"ground_truth": "noc"}
    assert occ.occluded is None
    assert occ.valid.sum() > noc.valid.sum()


@pytest.mark.parametrize("lost", ["image_2/000001_10.png", "image_2/000001_11.png", "flow_occ/000001_10.png"])
def test_kitti_never_pairs_the_wrong_files(tmp_path: Path, lost: str) -> None:
    kitti(tmp_path, ["000000", "000001", "000002"])
    (tmp_path / lost).unlink()
    refused("kitti2015", tmp_path, f"{lost}: missing")


def test_a_missing_noc_map_costs_only_what_it_holds(tmp_path: Path) -> None:
    """The paper's evaluation needs only flow_occ."""
    kitti(tmp_path, ["000000", "000001", "000002"])
    (tmp_path / "flow_noc" / "000001_10.png").unlink()
    with pytest.warns(UserWarning, match=r"1 of 3 maps are missing \(000001_10.png") as caught:
        dataset = load_dataset("kitti2015", tmp_path)
    assert len(caught) == 1
    samples = [dataset.load(f"{number:06d}") for number in range(3)]
    assert [sample.occluded is None for sample in samples] == [False, True, False]
    assert all(sample.meta == {"ground_truth": "occ"} for sample in samples)


def test_kitti2012_chooses_colour_or_grey(tmp_path: Path) -> None:
    kitti(tmp_path, ["000000"], "image_0")
    kitti(tmp_path, ["000000"], "colored_0")
    for images, folder in {"auto": "colored_0", "colour": "colored_0", "grey": "image_0"}.items():
        assert load_dataset("kitti2012", tmp_path, images=images).files("000000")[0].parent.name == folder


def test_released_kitti_fc_folder_is_read(tmp_path: Path) -> None:
    kitti(tmp_path / "clean" / "val", ["000003", "000004"], noc=False)
    kitti(tmp_path / "clean" / "training", ["000005"], noc=False)
    for setting in ("fog_2", "fog_3", "brightness_5"):
        kitti(tmp_path / setting / "val", ["000003", "000004"], noc=False)
    dataset = load_dataset("kitti_fc_released", tmp_path)
    assert isinstance(dataset, PreCorrupted)
    assert dataset.keys() == ["000003", "000004"]
    assert load_dataset("kitti_fc_released", tmp_path, split="training").keys() == ["000005"]
    clean = tmp_path / "clean" / "val"
    shots = [clean / "image_2" / f"000004_{number}.png" for number in (10, 11)]
    check(dataset, "000004", *shots, clean / "flow_occ" / "000004_10.png")
    assert [name for name in ("fog", "high_light", "brightness", "snow") if dataset.has_corrupted(name)] == [
        "fog",
        "high_light",
        "brightness",
    ]
    for frame, number in zip(dataset.corrupted("000004", "high_light", 5), (10, 11), strict=True):
        expected = tmp_path / "brightness_5" / "val" / "image_2" / f"000004_{number}.png"
        np.testing.assert_array_equal(frame, read_image(expected))
    with pytest.raises(DataError, match=r"fog_1: no such folder; severities of fog in this release: 2, 3"):
        dataset.corrupted("000003", "fog", 1)
    removed = tmp_path / "fog_2" / "val" / "image_2" / "000003_11.png"
    removed.unlink()
    with pytest.raises(DataError, match=r"000003_11\.png: missing"):
        dataset.corrupted("000003", "fog", 2)
    picture(removed, HEIGHT + 2)
    with pytest.raises(DataError, match="frames differ in size"):
        dataset.corrupted("000003", "fog", 2)


def test_ground_truth_of_a_different_size_or_without_a_pixel_is_refused(tmp_path: Path) -> None:
    kitti(tmp_path, ["000000", "000001", "000002"], noc=False)
    flow(tmp_path / "flow_occ" / "000000_10.png", None, HEIGHT + 1, WIDTH)
    flow(tmp_path / "flow_occ" / "000001_10.png", np.zeros((HEIGHT, WIDTH), bool))
    picture(tmp_path / "image_2" / "000002_11.png", HEIGHT, WIDTH + 1)
    dataset = load_dataset("kitti2015", tmp_path)
    with pytest.raises(DataError, match=r"the flow is 7x8, but the frame 000000_10\.png is 6x8"):
        dataset.load("000000")
    with pytest.raises(DataError, match="no pixel with known flow"):
        dataset.load("000001")
    with pytest.raises(DataError, match=r"000002_10\.png is 6x8, .*000002_11\.png is 6x9"):
        dataset.load("000002")
    with pytest.raises(UsageError, match="no sample '000009'; keys look like"):
        dataset.load("000009")

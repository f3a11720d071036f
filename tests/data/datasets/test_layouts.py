"""Readers of non-KITTI datasets find the files that belong together in small folders, and reject invalid input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import load_dataset
from robustflow.media.flow import read_flow
from robustflow.media.images import read_image

from .layouts import HEIGHT, WIDTH, check, flow, kitti, picture, placed, refused, sintel, spring


def test_middlebury_folder_is_read(tmp_path: Path) -> None:
    for scene in ("Venus", "Urban2", "Walking"):
        for number in range(7, 15):
            picture(tmp_path / "other-data" / scene / f"frame{number:02d}.png")
    flows = [flow(tmp_path / "other-gt-flow" / scene / "flow10.flo") for scene in ("Venus", "Urban2")]
    assert not np.array_equal(*flows)
    dataset = load_dataset("middlebury", tmp_path)
    assert dataset.keys() == ["Urban2", "Venus"]
    shots = [tmp_path / "other-data" / "Venus" / f"frame{number}.png" for number in (10, 11)]
    check(dataset, "Venus", *shots, tmp_path / "other-gt-flow" / "Venus" / "flow10.flo")
    shots[1].unlink()
    refused("middlebury", tmp_path, r"frame11\.png: missing")


def test_sintel_folder_is_read(tmp_path: Path) -> None:
    folder = sintel(tmp_path)
    for render_pass in ("clean", "final"):
        dataset = load_dataset("sintel", tmp_path, render_pass=render_pass)
        assert dataset.keys() == [f"{scene}/frame_{n:04d}" for scene in ("alley_1", "market_2") for n in (1, 2)]
        sample = dataset.load("market_2/frame_0002")
        assert sample.group == "market_2"
        names = [path.relative_to(folder).as_posix() for path in dataset.files("market_2/frame_0002")]
        assert names == [
            f"{render_pass}/market_2/frame_0002.png",
            f"{render_pass}/market_2/frame_0003.png",
            "flow/market_2/frame_0002.flo",
            "occlusions/market_2/frame_0002.png",
            "invalid/market_2/frame_0002.png",
        ]
        np.testing.assert_array_equal(sample.frames[1], read_image(folder / names[1]))
        np.testing.assert_array_equal(sample.occluded, np.eye(HEIGHT, WIDTH, dtype=bool))
        np.testing.assert_array_equal(sample.valid, np.eye(HEIGHT, WIDTH, dtype=bool)[::-1])
        assert (sample.flow[~sample.valid] == 0).all()


def test_sintel_without_maps_and_other_passes(tmp_path: Path) -> None:
    folder = sintel(tmp_path, maps=False)
    (folder / "clean").rename(folder / "my_pass")
    refused("sintel", tmp_path, "no pass 'clean'")
    shots = [folder / "my_pass" / "alley_1" / f"frame_000{n}.png" for n in (1, 2)]
    dataset = load_dataset("sintel", folder, render_pass="my_pass")
    check(dataset, "alley_1/frame_0001", *shots, folder / "flow" / "alley_1" / "frame_0001.flo")
    assert dataset.load("alley_1/frame_0001").occluded is None


@pytest.mark.parametrize(
    "lost",
    ["clean/alley_1/frame_0002.png", "clean/alley_1/frame_0003.png", "flow/alley_1/frame_0001.flo",
     "occlusions/alley_1/frame_0002.png", "invalid/alley_1/frame_0002.png"],
)  # fmt: skip
def test_sintel_with_missing_files_is_refused(tmp_path: Path, lost: str) -> None:
    folder = sintel(tmp_path)
    (folder / lost).unlink()
    refused("sintel", tmp_path, f"{lost}: missing")


def test_hd1k_folder_is_read(tmp_path: Path) -> None:
    images, flows = tmp_path / "hd1k_input" / "image_2", tmp_path / "hd1k_flow_gt" / "flow_occ"
    for sequence, count in (("000000", 3), ("000001", 2)):
        for number in range(count):
            picture(images / f"{sequence}_{number:04d}.png")
            flow(flows / f"{sequence}_{number:04d}.png")
    dataset = load_dataset("hd1k", tmp_path)
    assert dataset.keys() == ["000000_0000", "000000_0001", "000001_0000"]
    shots = [images / f"000000_000{n}.png" for n in (1, 2)]
    check(dataset, "000000_0001", *shots, flows / "000000_0001.png")
    assert dataset.load("000000_0001").group == "000000"
    (flows / "000000_0000.png").unlink()
    refused("hd1k", tmp_path, r"flow_occ/000000_0000\.png: missing")
    flow(flows / "000000_0000.png")
    (images / "000000_0001.png").unlink()
    refused("hd1k", tmp_path, r"image_2/000000_0001\.png: missing")


def test_spring_folder_is_read(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    train = spring(tmp_path)
    for root in (tmp_path, train):
        assert load_dataset("spring", root).keys() == ["0001/0001", "0001/0002", "0007/0001", "0007/0002"]
    for side in ("left", "right"):
        forward = load_dataset("spring", tmp_path, side=side)
        backward = load_dataset("spring", tmp_path, side=side, direction="BW")
        assert backward.keys() == ["0001/0002", "0001/0003", "0007/0002", "0007/0003"]
        for dataset, kind, other in ((forward, "FW", 3), (backward, "BW", 1)):
            sample = dataset.load("0007/0002")
            name = f"flow_{kind}_{side}"
            stored, valid = read_flow(train / "0007" / name / f"{name}_0002.flo5")
            np.testing.assert_array_equal(sample.flow, stored[::2, ::2])
            np.testing.assert_array_equal(sample.valid, valid[::2, ::2])
            for frame, number in zip(sample.frames, (2, other), strict=True):
                path = train / "0007" / f"frame_{side}" / f"frame_{side}_{number:04d}.png"
                np.testing.assert_array_equal(frame, read_image(path))
    (train / "0001" / "frame_left" / "frame_left_0002.png").unlink()
    refused("spring", tmp_path, r"frame_left_0002\.png: missing")
    (train / "0007" / "flow_FW_right" / "flow_FW_right_0001.flo5").unlink()
    refused("spring", tmp_path, r"flow_FW_right_0001\.flo5: missing", side="right")


def test_flyingchairs_folder_is_read(tmp_path: Path) -> None:
    data = tmp_path / "data"
    for number in (1, 2, 3):
        picture(data / f"{number:05d}_img1.ppm")
        picture(data / f"{number:05d}_img2.ppm")
        flow(data / f"{number:05d}_flow.flo")
    for root in (tmp_path, data):
        dataset = load_dataset("flyingchairs", root)
        assert dataset.keys() == ["00001", "00002", "00003"]
        shots = [data / f"00002_img{n}.ppm" for n in (1, 2)]
        check(dataset, "00002", *shots, data / "00002_flow.flo")
    refused("flyingchairs", tmp_path, "FlyingChairs_train_val.txt", split="val")
    (tmp_path / "FlyingChairs_train_val.txt").write_text("1\n2\n1\n")
    assert load_dataset("flyingchairs", tmp_path, split="val").keys() == ["00002"]
    assert load_dataset("flyingchairs", data, split="train").keys() == ["00001", "00003"]
    (tmp_path / "FlyingChairs_train_val.txt").write_text("1\n2\n")
    refused("flyingchairs", tmp_path, "at least 3 pairs", split="val")
    (tmp_path / "empty" / "data").mkdir(parents=True)
    refused("flyingchairs", tmp_path / "empty", "contains no image pair", split="val")
    (data / "00002_img2.ppm").unlink()
    refused("flyingchairs", tmp_path, r"00002_img2\.ppm: missing")


def tartanair(root: Path, environment: str = "office", inner: bool = False) -> Path:
    folder = root / environment / (environment if inner else ".")
    for level, flight in (("Easy", "P000"), ("Hard", "P001")):
        place = folder / level / flight
        for number in (0, 1, 2):
            picture(place / "image_left" / f"{number:06d}_left.png")
        for number in (0, 1):
            name = placed(place / "flow" / f"{number:06d}_{number + 1:06d}")
            values = np.arange(HEIGHT * WIDTH * 2, dtype=np.float32).reshape(HEIGHT, WIDTH, 2) / 8 + number
            values[0, 0] = np.nan
            np.save(f"{name}_flow.npy", values)
            mask = np.zeros((HEIGHT, WIDTH), np.uint8)
            mask[1:, :3] = 1, 10, 100
            np.save(f"{name}_mask.npy", mask)
    return folder


@pytest.mark.parametrize("inner", [False, True])
def test_tartanair_folder_is_read(tmp_path: Path, inner: bool) -> None:
    folder = tartanair(tmp_path, inner=inner)
    for root in (tmp_path, tmp_path / "office"):
        dataset = load_dataset("tartanair", root)
        keys = [f"office/{level}/{n:06d}" for level in ("Easy/P000", "Hard/P001") for n in (0, 1)]
        assert dataset.keys() == keys
    assert load_dataset("tartanair", tmp_path, difficulty="Hard").keys() == keys[2:]
    sample = dataset.load("office/Hard/P001/000001")
    place = folder / "Hard" / "P001"
    stored = np.load(place / "flow" / "000001_000002_flow.npy")
    stored[0, 0], stored[1:, 2] = 0, 0
    np.testing.assert_array_equal(sample.flow, stored)
    np.testing.assert_array_equal(sample.valid, stored.any(axis=2))
    assert sample.occluded[1:, :2].all()
    assert sample.occluded.sum() == 2 * (HEIGHT - 1)
    for frame, number in zip(sample.frames, (1, 2), strict=True):
        np.testing.assert_array_equal(frame, read_image(place / "image_left" / f"{number:06d}_left.png"))
    np.save(place / "flow" / "000000_000001_flow.npy", np.zeros((2, 2), np.float32))
    (place / "flow" / "000001_000002_flow.npy").write_bytes(b"no array")
    with pytest.raises(DataError, match=r"is not a flow; expected real numbers of shape \(H, W, 2\)"):
        dataset.load("office/Hard/P001/000000")
    with pytest.raises(DataError, match=r"flow\.npy: damaged or truncated"):
        dataset.load("office/Hard/P001/000001")
    with open(place / "flow" / "000001_000002_flow.npy", "wb") as file:  # the header claims 8 TB
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (10**6, 10**6, 2)})
    with pytest.raises(DataError, match=r"the header claims 1000000x1000000 pixels"):
        dataset.load("office/Hard/P001/000001")
    (place / "flow" / "000001_000002_mask.npy").unlink()
    refused("tartanair", tmp_path, r"000001_000002_mask\.npy: missing")


def test_flyingthings3d_subset_is_read(tmp_path: Path) -> None:
    for number in (0, 1, 2, 3, 4):  # frames 0 to 2 and 3 to 4 are scenes
        picture(tmp_path / "train/image_final/right" / f"{number:07d}.png")
    for number in (0, 1, 3):
        flow(tmp_path / "train/flow/right/into_future" / f"{number:07d}.flo")
        flow(tmp_path / "train/flow/right/into_past" / f"{number + 1:07d}.flo")
    options = {"render_pass": "final", "side": "right"}
    dataset = load_dataset("flyingthings3d", tmp_path, **options)
    assert dataset.keys() == [f"train/{n:07d}" for n in (0, 1, 3)]
    assert [sample.group for sample in dataset] == ["train/0000000", "train/0000000", "train/0000003"]
    images, flows = tmp_path / "train/image_final/right", tmp_path / "train/flow/right"
    check(dataset, "train/0000001", *(images / f"{n:07d}.png" for n in (1, 2)), flows / "into_future/0000001.flo")
    past = load_dataset("flyingthings3d", tmp_path, direction="past", **options)
    check(past, "train/0000004", *(images / f"{n:07d}.png" for n in (4, 3)), flows / "into_past/0000004.flo")
    refused("flyingthings3d", tmp_path, r"train/image_final/left: no such folder", render_pass="final")
    refused("flyingthings3d", tmp_path, "of the subset")
    (images / "0000002.png").unlink()
    refused("flyingthings3d", tmp_path, r"0000002\.png: missing", **options)


def test_training_truth_ignores_maps_other_than_flow_where_possible(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    sintel(tmp_path / "sintel")
    dataset = load_dataset("sintel", tmp_path / "sintel")
    assert dataset.training_truth(dataset.pair(dataset.keys()[0])).valid.all()
    assert not dataset.load(dataset.keys()[0]).valid.all()
    spring(tmp_path / "spring")
    tartanair(tmp_path / "tartanair")
    for name in ("spring", "tartanair"):
        dataset = load_dataset(name, tmp_path / name)
        key = dataset.keys()[0]
        truth, sample = dataset.training_truth(dataset.pair(key)), dataset.load(key)
        assert truth.flow.shape[:2] == sample.frames[0].shape[:2]
        np.testing.assert_array_equal(truth.flow, sample.flow)


def test_flyingthings3d_folder_is_read(tmp_path: Path) -> None:
    for split, scene in (("TRAIN", "A/0000"), ("TRAIN", "C/0012"), ("TEST", "B/0001")):
        for side in ("left", "right"):
            for number in (6, 7, 8):
                for kind in ("cleanpass", "finalpass"):
                    picture(tmp_path / f"frames_{kind}" / split / scene / side / f"{number:04d}.png")
                for time in ("Future", "Past"):
                    folder = tmp_path / "optical_flow" / split / scene / f"into_{time.lower()}" / side
                    flow(folder / f"OpticalFlowInto{time}_{number:04d}_{side[0].upper()}.pfm")
    dataset = load_dataset("flyingthings3d", tmp_path)
    assert dataset.keys() == [f"TRAIN/{scene}/{n:04d}" for scene in ("A/0000", "C/0012") for n in (6, 7)]
    images, flows = tmp_path / "frames_cleanpass/TRAIN/A/0000/left", tmp_path / "optical_flow/TRAIN/A/0000"
    truth = flows / "into_future/left/OpticalFlowIntoFuture_0006_L.pfm"
    check(dataset, "TRAIN/A/0000/0006", images / "0006.png", images / "0007.png", truth)
    options = {"render_pass": "final", "split": "TEST", "side": "right", "direction": "past"}
    dataset = load_dataset("flyingthings3d", tmp_path, **options)
    assert dataset.keys() == ["TEST/B/0001/0007", "TEST/B/0001/0008"]
    images, flows = tmp_path / "frames_finalpass/TEST/B/0001/right", tmp_path / "optical_flow/TEST/B/0001"
    truth = flows / "into_past/right/OpticalFlowIntoPast_0008_R.pfm"
    check(dataset, "TEST/B/0001/0008", images / "0008.png", images / "0007.png", truth)
    truth.unlink()
    refused("flyingthings3d", tmp_path, r"OpticalFlowIntoPast_0008_R\.pfm: missing", **options)
    (tmp_path / "frames_cleanpass/TRAIN/A/0000/left/0007.png").unlink()
    refused("flyingthings3d", tmp_path, r"with a stride of 1, the frame after 0006\.png is missing")


def test_gopro_folder_is_read(tmp_path: Path) -> None:
    for split, sequence in (("train", "GOPR0372_07_00"), ("test", "GOPR0384_11_00")):
        for kind in ("blur", "sharp"):
            for number in range(47, 52):
                picture(tmp_path / split / sequence / kind / f"{number:06d}.png")
    group = "test/GOPR0384_11_00"
    dataset = load_dataset("gopro", tmp_path, split="test", step=2)
    assert dataset.keys() == [f"{group}/{n:06d}" for n in (47, 48, 49)]
    shots = [tmp_path / group / "sharp" / f"{n:06d}.png" for n in (48, 50)]
    check(dataset, f"{group}/000048", *shots, None)
    assert dataset.load(f"{group}/000048").group == group
    assert len(load_dataset("gopro", tmp_path).keys()) == 8
    assert load_dataset("gopro", tmp_path, images="blur").files(f"{group}/000047")[0].parent.name == "blur"
    refused("gopro", tmp_path, "blur_gamma: no such folder", images="blur_gamma")
    refused("gopro", tmp_path, "5 frames, but pairs with a step of 5 need 6 or more", step=5)
    shots[0].unlink()
    refused("gopro", tmp_path, r"with a stride of 1, the frame after 000047\.png is missing")


def test_gopro_reads_plain_folders_of_frames(tmp_path: Path) -> None:
    for number in (1, 9, 17):  # every eighth frame
        picture(tmp_path / "GOPR0384_11_00" / f"{number:06d}.png")
    dataset = load_dataset("gopro", tmp_path)
    assert dataset.keys() == ["GOPR0384_11_00/000001", "GOPR0384_11_00/000009"]
    refused("gopro", tmp_path / "GOPR0384_11_00", "a single sequence; give its parent folder")


ROOTS = {
    "kitti2015": lambda root: kitti(root / "training", ["000000"]),
    "kitti2012": lambda root: kitti(root / "training", ["000000"], "image_0"),
    "sintel": sintel,
    "spring": spring,
    "kitti_fc_released": lambda root: kitti(root / "clean" / "val", ["000000"]),
}


@pytest.mark.parametrize("name", ROOTS)
def test_folder_one_level_too_high_or_low_is_refused_with_the_right_one(tmp_path: Path, name: str) -> None:
    if name == "spring":
        pytest.importorskip("h5py")
    root = tmp_path / "here"
    ROOTS[name](root)
    load_dataset(name, root)
    refused(name, tmp_path, rf"not laid out like .*expected .*did you mean {root}")
    low = next(path for path in sorted(root.rglob("*")) if path.is_file()).parent
    refused(name, low, "did you mean")


@pytest.mark.parametrize(
    "name",
    ["kitti2015", "kitti2012", "middlebury", "sintel", "hd1k", "spring", "flyingchairs", "flyingthings3d", "tartanair",
     "gopro", "kitti_fc_released", "folder"],
)  # fmt: skip
def test_missing_and_empty_folders_are_refused(tmp_path: Path, name: str) -> None:
    refused(name, tmp_path / "missing", "missing: no such folder")
    (tmp_path / "empty").mkdir()
    refused(name, tmp_path / "empty", "the folder is empty; expected|contains no images")
    with pytest.raises(UsageError, match="--data FOLDER"):
        load_dataset(name)

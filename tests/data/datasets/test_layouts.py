"""Each dataset's reader finds the files that belong together in a small folder, and names the file that is missing."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import DATASETS, PreCorrupted, load_dataset
from robustflow.data.datasets.dataset import Clips, CorruptedClips, has_clips
from robustflow.media.flow import read_flow
from robustflow.media.images import read_image
from tests.data.video import clips
from tests.refusals import refusal

from .layouts import HEIGHT, WIDTH, flow, kitti, picture, placed, sintel, spring


def refused(name: str, root: Path, culprit: Path, **options: object) -> None:
    refusal(lambda: load_dataset(name, root, **options), DataError, culprit)


def middlebury(root: Path) -> None:
    for scene, numbers in (("Venus", range(7, 15)), ("Urban2", (10, 11)), ("Walking", range(7, 15))):
        for number in numbers:
            picture(root / "other-data" / scene / f"frame{number:02d}.png")
    for scene in ("Venus", "Urban2"):
        flow(root / "other-gt-flow" / scene / "flow10.flo")


def hd1k(root: Path) -> None:
    for sequence, count in (("000000", 3), ("000001", 2)):
        for number in range(count):
            picture(root / "hd1k_input/image_2" / f"{sequence}_{number:04d}.png")
            flow(root / "hd1k_flow_gt/flow_occ" / f"{sequence}_{number:04d}.png")


def chairs(root: Path) -> None:
    for number in (1, 2, 3):
        for frame in (1, 2):
            picture(root / "data" / f"{number:05d}_img{frame}.ppm")
        flow(root / "data" / f"{number:05d}_flow.flo")


def tartanair(root: Path, inner: bool = False) -> None:
    for level, flight in (("Easy", "P000"), ("Hard", "P001")):
        place = root / "office" / ("office" if inner else ".") / level / flight
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


def things(root: Path) -> None:
    for split, scene in (("TRAIN", "A/0000"), ("TRAIN", "C/0012"), ("TEST", "B/0001")):
        for side in ("left", "right"):
            for number in (6, 7, 8):
                for kind in ("cleanpass", "finalpass"):
                    picture(root / f"frames_{kind}" / split / scene / side / f"{number:04d}.png")
                for time in ("Future", "Past"):
                    folder = root / "optical_flow" / split / scene / f"into_{time.lower()}" / side
                    flow(folder / f"OpticalFlowInto{time}_{number:04d}_{side[0].upper()}.pfm")


def subset(root: Path) -> None:
    for number in (0, 1, 2, 3, 4):  # frames 0 to 2 and 3 to 4 are scenes
        picture(root / "train/image_final/right" / f"{number:07d}.png")
    for number in (0, 1, 3):
        flow(root / "train/flow/right/into_future" / f"{number:07d}.flo")
        flow(root / "train/flow/right/into_past" / f"{number + 1:07d}.flo")


def gopro(root: Path) -> None:
    for sequence in ("train/GOPR0372_07_00", "test/GOPR0384_11_00"):
        for kind in ("blur", "sharp"):
            for number in range(47, 52):
                picture(root / sequence / kind / f"{number:06d}.png")


def plain_gopro(root: Path) -> None:
    for number in (1, 9, 17):  # every eighth frame
        picture(root / "GOPR0384_11_00" / f"{number:06d}.png")


def multiview(root: Path) -> None:
    for part in ("training", "testing"):
        for scene in ("000000", "000001"):
            for number in range(21):
                picture(root / part / "image_3" / f"{scene}_{number:02d}.png")


def raw(root: Path) -> None:
    for drive in ("2011_09_26_drive_0009_sync", "2011_09_26_drive_0099_sync"):  # 0009 contains pairs of KITTI 2015
        for number in (0, 1, 2, 4, 5):  # frame 3 is missing, as happens in some drives
            picture(root / "2011_09_26" / drive / "image_02/data" / f"{number:010d}.png")


def released(root: Path) -> None:
    kitti(root / "clean/val", ["000003", "000004"], noc=False)
    kitti(root / "clean/training", ["000005"], noc=False)
    for setting in ("fog_2", "fog_3", "brightness_5"):
        kitti(root / setting / "val", ["000003", "000004"], noc=False)


class Case(NamedTuple):
    """A dataset's options, folder, keys, and the files and group of one of its pairs; files whose loss is refused."""

    name: str
    options: dict[str, object]
    make: Callable[[Path], object]
    keys: list[str]
    key: str
    files: list[str]
    group: str
    lost: list[str]
    roots: tuple[str, ...] = (".",)


def under(folder: str, *names: str) -> list[str]:
    return [f"{folder}/{name}" for name in names]


_SINTEL = ["alley_1/frame_0001", "alley_1/frame_0002", "market_2/frame_0001", "market_2/frame_0002"]
_SINTEL_FILES = ["market_2/frame_0002.png", "market_2/frame_0003.png"]
_MAPS = ["flow/market_2/frame_0002.flo", *(f"{kind}/market_2/frame_0002.png" for kind in ("occlusions", "invalid"))]
_TARTAN = [f"office/{place}/{n:06d}" for place in ("Easy/P000", "Hard/P001") for n in (0, 1)]
_TARTAN_FLOW = ["flow/000001_000002_flow.npy", "flow/000001_000002_mask.npy"]
_KITTI = under("training", "image_2/000010_10.png", "image_2/000010_11.png", "flow_occ/000010_10.png")
_KITTI_2012 = under("training", "image_0/000010_10.png", "image_0/000010_11.png", "flow_occ/000010_10.png")
CASES = {
    "middlebury": Case(
        "middlebury", {}, middlebury, ["Urban2", "Venus"], "Venus",
        [*under("other-data/Venus", "frame10.png", "frame11.png"), "other-gt-flow/Venus/flow10.flo"], "",
        ["other-data/Venus/frame10.png", "other-data/Urban2/frame11.png"],
    ),
    **{
        f"sintel {kind}": Case(
            "sintel", {"render_pass": kind}, sintel, _SINTEL, "market_2/frame_0002",
            [f"training/{path}" for path in (*(f"{kind}/{name}" for name in _SINTEL_FILES), *_MAPS)], "market_2",
            [f"training/{path}" for path in (*(f"{kind}/{name}" for name in _SINTEL_FILES), *_MAPS)],
            (".", "training"),
        )
        for kind in ("clean", "final")
    },
    "hd1k": Case(
        "hd1k", {}, hd1k, ["000000_0000", "000000_0001", "000001_0000"], "000000_0001",
        [*under("hd1k_input/image_2", "000000_0001.png", "000000_0002.png"), "hd1k_flow_gt/flow_occ/000000_0001.png"],
        "000000", ["hd1k_flow_gt/flow_occ/000000_0000.png", "hd1k_input/image_2/000000_0001.png"],
    ),
    "chairs": Case(
        "flyingchairs", {}, chairs, ["00001", "00002", "00003"], "00002",
        under("data", "00002_img1.ppm", "00002_img2.ppm", "00002_flow.flo"), "",
        under("data", "00002_img1.ppm", "00002_img2.ppm", "00002_flow.flo"), (".", "data"),
    ),
    "things": Case(
        "flyingthings3d", {}, things, [f"TRAIN/{scene}/{n:04d}" for scene in ("A/0000", "C/0012") for n in (6, 7)],
        "TRAIN/A/0000/0006", [*under("frames_cleanpass/TRAIN/A/0000/left", "0006.png", "0007.png"),
        "optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm"], "TRAIN/A/0000",
        ["optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm"],
    ),
    "things of the past": Case(
        "flyingthings3d", {"render_pass": "final", "split": "TEST", "side": "right", "direction": "past"}, things,
        ["TEST/B/0001/0007", "TEST/B/0001/0008"], "TEST/B/0001/0008",
        [*under("frames_finalpass/TEST/B/0001/right", "0008.png", "0007.png"),
         "optical_flow/TEST/B/0001/into_past/right/OpticalFlowIntoPast_0008_R.pfm"], "TEST/B/0001",
        ["optical_flow/TEST/B/0001/into_past/right/OpticalFlowIntoPast_0008_R.pfm"],
    ),
    "things' subset": Case(
        "flyingthings3d", {"render_pass": "final", "side": "right"}, subset, [f"train/{n:07d}" for n in (0, 1, 3)],
        "train/0000003", [*under("train/image_final/right", "0000003.png", "0000004.png"),
        "train/flow/right/into_future/0000003.flo"], "train/0000003", ["train/image_final/right/0000002.png"],
    ),
    "things' subset of the past": Case(
        "flyingthings3d", {"render_pass": "final", "side": "right", "direction": "past"}, subset,
        [f"train/{n:07d}" for n in (1, 2, 4)], "train/0000002",
        [*under("train/image_final/right", "0000002.png", "0000001.png"), "train/flow/right/into_past/0000002.flo"],
        "train/0000001", ["train/image_final/right/0000002.png"],
    ),
    **{
        f"spring {side} {direction}": Case(
            "spring", {"side": side, "direction": direction}, spring,
            [f"{sequence}/{first + n:04d}" for sequence in ("0001", "0007") for n in (0, 1)], "0007/0002",
            [*(f"train/0007/frame_{side}/frame_{side}_{n:04d}.png" for n in (2, 5 - 2 * first)),
             f"train/0007/flow_{direction}_{side}/flow_{direction}_{side}_0002.flo5"], "0007",
            [f"train/0001/frame_{side}/frame_{side}_0002.png",
             f"train/0007/flow_{direction}_{side}/flow_{direction}_{side}_0002.flo5"], (".", "train"),
        )
        for side in ("left", "right") for direction, first in (("FW", 1), ("BW", 2))
    },
    "tartanair": Case(
        "tartanair", {}, tartanair, _TARTAN, "office/Hard/P001/000001",
        under("office/Hard/P001", "image_left/000001_left.png", "image_left/000002_left.png", *_TARTAN_FLOW),
        "office/Hard/P001", under("office/Hard/P001", *_TARTAN_FLOW), (".", "office"),
    ),
    "tartanair nested": Case(
        "tartanair", {"difficulty": "Hard"}, lambda root: tartanair(root, inner=True), _TARTAN[2:], _TARTAN[3],
        under("office/office/Hard/P001", "image_left/000001_left.png", "image_left/000002_left.png", *_TARTAN_FLOW),
        "office/Hard/P001", [], (".", "office"),
    ),
    "gopro": Case(
        "gopro", {"split": "test", "step": 2}, gopro, [f"test/GOPR0384_11_00/{n:06d}" for n in (47, 48, 49)],
        "test/GOPR0384_11_00/000048", under("test/GOPR0384_11_00/sharp", "000048.png", "000050.png"),
        "test/GOPR0384_11_00", [],
    ),
    "gopro plain": Case(
        "gopro", {}, plain_gopro, ["GOPR0384_11_00/000001", "GOPR0384_11_00/000009"], "GOPR0384_11_00/000009",
        under("GOPR0384_11_00", "000009.png", "000017.png"), "GOPR0384_11_00", [],
    ),
    "kitti2015": Case(
        "kitti2015", {}, lambda root: kitti(root / "training", ["000010", "000002"]), ["000002", "000010"], "000010",
        [*_KITTI, "training/flow_noc/000010_10.png"], "2011_09_26_drive_0009", _KITTI, (".", "training"),
    ),
    "kitti2012": Case(
        "kitti2012", {}, lambda root: kitti(root / "training", ["000010", "000002"], "image_0", noc=False),
        ["000002", "000010"], "000010", _KITTI_2012, "2011_09_30_drive_0033", _KITTI_2012, (".", "training"),
    ),
    "kitti-fc": Case(
        "kitti_fc_released", {}, released, ["000003", "000004"], "000004",
        under("clean/val", "image_2/000004_10.png", "image_2/000004_11.png", "flow_occ/000004_10.png"),
        "unmapped_000004_000006", under("clean/val", "image_2/000004_11.png", "flow_occ/000004_10.png"),
    ),
    "kitti-fc training": Case(
        "kitti_fc_released", {"split": "training"}, released, ["000005"], "000005",
        under("clean/training", "image_2/000005_10.png", "image_2/000005_11.png", "flow_occ/000005_10.png"),
        "unmapped_000004_000006", [],
    ),
    "multi-view": Case(
        "kitti_multiview", {"part": "testing", "camera": "right"}, multiview,
        [f"testing/image_3/{s}_{n:02d}" for s in ("000000", "000001") for n in (*range(8), *range(13, 20))],
        "testing/image_3/000001_13", under("testing/image_3", "000001_13.png", "000001_14.png"), "testing/000001", [],
    ),
    "raw": Case(
        "kitti_raw", {}, raw, [f"2011_09_26_drive_0099_sync/image_02/{n:010d}" for n in (0, 1, 4)],
        "2011_09_26_drive_0099_sync/image_02/0000000004",
        under("2011_09_26/2011_09_26_drive_0099_sync/image_02/data", "0000000004.png", "0000000005.png"),
        "2011_09_26_drive_0099_sync", [], (".", "2011_09_26"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_pairs_have_the_contents_of_their_files(tmp_path: Path, case: Case) -> None:
    if case.name == "spring":
        pytest.importorskip("h5py")
    case.make(tmp_path)
    for root in case.roots:
        dataset = load_dataset(case.name, tmp_path / root, **case.options)
        assert dataset.keys() == case.keys
    files = [tmp_path / path for path in case.files]
    assert dataset.files(case.key) == files
    sample = dataset.load(case.key)
    assert sample.group == (case.group or case.key)
    for frame, path in zip(sample.frames, files[:2], strict=True):
        np.testing.assert_array_equal(frame, read_image(path))
    assert (sample.flow is not None) == dataset.has_flow == (len(files) > 2)
    if len(files) > 2 and files[2].suffix != ".npy":
        stored, valid = read_flow(files[2])
        half = slice(None, None, 2 if case.name == "spring" else 1)
        if case.name == "sintel":
            valid = valid & ~read_image(files[4]).any(axis=2)
        np.testing.assert_array_equal(sample.valid, valid[half, half])
        np.testing.assert_array_equal(sample.flow[sample.valid], stored[half, half][sample.valid])
        assert not sample.flow[~sample.valid].any()


@pytest.mark.parametrize(("case", "lost"), [(case, lost) for case in CASES.values() for lost in case.lost])
def test_a_missing_file_is_refused_by_its_path(tmp_path: Path, case: Case, lost: str) -> None:
    if case.name == "spring":
        pytest.importorskip("h5py")
    case.make(tmp_path)
    (tmp_path / lost).unlink()
    refused(case.name, tmp_path, tmp_path / lost, **case.options)


@pytest.mark.parametrize("name", ["things", "gopro", "gopro plain"])
def test_a_gap_in_a_sequence_is_refused_by_its_folder(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    case.make(tmp_path)
    folder = (tmp_path / case.files[0]).parent
    numbers = sorted(folder.iterdir())
    picture(folder / f"{int(numbers[-1].stem) + 20:0{len(numbers[0].stem)}d}.png")
    refused(case.name, tmp_path, folder, **case.options)


def test_sintel_reads_any_pass_and_its_maps(tmp_path: Path) -> None:
    folder = sintel(tmp_path)
    sample = load_dataset("sintel", tmp_path).load("market_2/frame_0002")
    np.testing.assert_array_equal(sample.occluded, np.eye(HEIGHT, WIDTH, dtype=bool))
    np.testing.assert_array_equal(sample.valid, np.eye(HEIGHT, WIDTH, dtype=bool)[::-1])
    (folder / "clean").rename(folder / "my_pass")
    refused("sintel", tmp_path, folder)
    for kind in ("occlusions", "invalid"):
        (folder / kind).rename(tmp_path / kind)
    sample = load_dataset("sintel", folder, render_pass="my_pass").load("alley_1/frame_0001")
    assert sample.occluded is None
    assert sample.valid.all()


def test_flyingchairs_are_split_by_its_file(tmp_path: Path) -> None:
    chairs(tmp_path)
    refused("flyingchairs", tmp_path, tmp_path / "data", split="val")
    (tmp_path / "FlyingChairs_train_val.txt").write_text("1\n2\n1\n")
    assert load_dataset("flyingchairs", tmp_path, split="val").keys() == ["00002"]
    assert load_dataset("flyingchairs", tmp_path / "data", split="train").keys() == ["00001", "00003"]
    (tmp_path / "FlyingChairs_train_val.txt").write_text("1\n2\n")
    refused("flyingchairs", tmp_path, tmp_path / "FlyingChairs_train_val.txt", split="val")


def test_tartanair_masks_occluded_and_unseen_pixels(tmp_path: Path) -> None:
    tartanair(tmp_path)
    dataset, key = load_dataset("tartanair", tmp_path), "office/Hard/P001/000001"
    place, sample = tmp_path / "office/Hard/P001/flow", dataset.load(key)
    stored = np.load(place / "000001_000002_flow.npy")
    stored[0, 0], stored[1:, 2] = 0, 0
    np.testing.assert_array_equal(sample.flow, stored)
    np.testing.assert_array_equal(sample.valid, stored.any(axis=2))
    assert sample.occluded[1:, :2].all()
    assert sample.occluded.sum() == 2 * (HEIGHT - 1)
    path = place / "000001_000002_flow.npy"
    np.save(path, np.zeros((2, 2), np.float32))
    refusal(lambda: dataset.load(key), DataError, path)


def test_training_truth_ignores_maps_other_than_flow_where_possible(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    for make in (sintel, spring, tartanair):
        make(tmp_path / make.__name__)
        dataset = load_dataset(make.__name__, tmp_path / make.__name__)
        key = dataset.keys()[0]
        truth, sample = dataset.training_truth(dataset.pair(key)), dataset.load(key)
        assert truth.valid.all() == (make is not tartanair)
        if make is not sintel:
            np.testing.assert_array_equal(truth.flow, sample.flow)


def test_gopro_has_kinds_of_images_and_steps(tmp_path: Path) -> None:
    gopro(tmp_path)
    assert len(load_dataset("gopro", tmp_path).keys()) == 8
    key = "test/GOPR0384_11_00/000047"
    assert load_dataset("gopro", tmp_path, images="blur").files(key)[0].parent.name == "blur"
    sequence = tmp_path / "train/GOPR0372_07_00"
    refused("gopro", tmp_path, sequence / "blur_gamma", images="blur_gamma")
    refused("gopro", tmp_path, sequence, step=5)
    plain_gopro(tmp_path / "plain")
    refused("gopro", tmp_path / "plain/GOPR0384_11_00", tmp_path / "plain/GOPR0384_11_00")


def test_kitti_needs_its_folders_and_no_others(tmp_path: Path) -> None:
    """The multi-view extension has more frames; 2012 has colour and grey ones; the paper needs only flow_occ."""
    for images in ("image_0", "colored_0"):
        kitti(tmp_path, ["000000", "000001", "000002"], images)
    refused("kitti2015", tmp_path, tmp_path)
    for images, folder in {"auto": "colored_0", "colour": "colored_0", "grey": "image_0"}.items():
        assert load_dataset("kitti2012", tmp_path, images=images).files("000000")[0].parent.name == folder
    (tmp_path / "flow_noc/000001_10.png").unlink()
    with pytest.warns(UserWarning, match="1 .*3") as caught:
        dataset = load_dataset("kitti2012", tmp_path)
    assert len(caught) == 1
    assert [sample.occluded is None for sample in dataset] == [False, True, False]
    sample = dataset.load("000000")
    assert sample.occluded[:-1, 0].all()
    assert not sample.occluded[:, 1:].any()
    assert not sample.occluded[~sample.valid].any()
    (tmp_path / "flow_occ").rename(tmp_path / "elsewhere")
    flow(tmp_path / "flow_noc/000001_10.png")
    noc = load_dataset("kitti2012", tmp_path)
    assert noc.non_occluded
    assert (sample.meta, noc.load("000000").meta) == ({"ground_truth": "occ"}, {"ground_truth": "noc"})
    assert noc.load("000000").occluded is None


def test_released_kitti_fc_reads_its_corrupted_frames(tmp_path: Path) -> None:
    released(tmp_path)
    dataset = load_dataset("kitti_fc_released", tmp_path)
    assert isinstance(dataset, PreCorrupted)
    known = [name for name in ("fog", "high_light", "brightness", "snow") if dataset.has_corrupted(name)]
    assert known == ["fog", "high_light", "brightness"]
    for frame, number in zip(dataset.corrupted("000004", "high_light", 5), (10, 11), strict=True):
        path = tmp_path / f"brightness_5/val/image_2/000004_{number}.png"
        np.testing.assert_array_equal(frame, read_image(path))
    refusal(lambda: dataset.corrupted("000003", "fog", 1), DataError, tmp_path / "fog_1")
    removed = tmp_path / "fog_2/val/image_2/000003_11.png"
    removed.unlink()
    refusal(lambda: dataset.corrupted("000003", "fog", 2), DataError, removed)
    picture(removed, HEIGHT + 2)
    refusal(lambda: dataset.corrupted("000003", "fog", 2), DataError, removed)


def test_files_that_do_not_match_are_refused(tmp_path: Path) -> None:
    kitti(tmp_path, ["000000", "000001", "000002"], noc=False)
    paths = tmp_path / "flow_occ/000000_10.png", tmp_path / "flow_occ/000001_10.png", tmp_path / "image_2/000002_11.png"
    flow(paths[0], None, HEIGHT + 1, WIDTH)
    flow(paths[1], np.zeros((HEIGHT, WIDTH), bool))
    picture(paths[2], HEIGHT, WIDTH + 1)
    dataset = load_dataset("kitti2015", tmp_path)
    for key, path in zip(dataset.keys(), paths, strict=True):
        refusal(lambda key=key: dataset.load(key), DataError, path)
    refusal(lambda: dataset.load("000009"), UsageError, "000009")


def test_multi_view_has_15_pairs_of_a_camera_in_each_scene(tmp_path: Path) -> None:
    multiview(tmp_path)
    assert len(load_dataset("kitti_multiview", tmp_path, camera="right").keys()) == 4 * 15  # as UPFlow, with one camera
    refused("kitti_multiview", tmp_path, tmp_path / "training/image_2")
    for path in tmp_path.glob("training/image_3/*"):
        if path.stem[-2:] not in ("10", "11"):
            path.unlink()
    refused("kitti_multiview", tmp_path, tmp_path, part="training", camera="right")


def test_raw_drives_of_evaluated_pairs_are_left_out_unless_asked_for(tmp_path: Path) -> None:
    raw(tmp_path)
    apart, every = (load_dataset("kitti_raw", tmp_path, drives=drives) for drives in ("apart", "all"))
    assert (apart.leaves_out_evaluated, every.leaves_out_evaluated, len(every.keys())) == (True, False, 6)
    names = [f"2011_09_26/2011_09_26_drive_0009_sync/image_02/data/{n:010d}.png" for n in (0, 2)]
    listing = tmp_path / "pairs.txt"
    listing.write_text(" ".join(names) + "\n")
    listed = load_dataset("kitti_raw", tmp_path, listing=str(listing))
    assert [path.name for path in listed.files(listed.keys()[0])] == ["0000000000.png", "0000000002.png"]
    for text, line in ((names[0], 1), ((" ".join(names) + "\n") * 2, 2)):
        listing.write_text(text)
        culprit = f"{listing}, line {line}"
        refusal(lambda: load_dataset("kitti_raw", tmp_path, listing=str(listing)), DataError, culprit)
    refused(
        "kitti_raw",
        tmp_path / "2011_09_26/2011_09_26_drive_0009_sync",
        tmp_path / "2011_09_26/2011_09_26_drive_0009_sync",
    )


@pytest.mark.parametrize("name", ["kitti2015", "kitti2012", "sintel clean", "spring left FW", "kitti-fc"])
def test_a_folder_one_level_too_high_or_low_is_refused_with_the_right_one(tmp_path: Path, name: str) -> None:
    if "spring" in name:
        pytest.importorskip("h5py")
    case, root = CASES[name], tmp_path / "here"
    case.make(root)
    for wrong in (tmp_path, next(path for path in sorted(root.rglob("*")) if path.is_file()).parent):
        error = refusal(lambda wrong=wrong: load_dataset(case.name, wrong), DataError, wrong)
        assert str(root) in str(error).removeprefix(str(wrong))


OURS = [name for name in DATASETS.names() if DATASETS.get(name).__module__.startswith("robustflow.")]


@pytest.mark.parametrize("name", [name for name in OURS if name not in ("motorcycle", "shapes")])
def test_missing_and_empty_folders_are_refused(tmp_path: Path, name: str) -> None:
    if name == "spring":
        pytest.importorskip("h5py")
    (tmp_path / "empty").mkdir()
    for folder in ("missing", "empty"):
        with pytest.raises(DataError) as caught:
            load_dataset(name, tmp_path / folder)
        assert str(tmp_path) in caught.value.culprit
    refusal(lambda: load_dataset(name), UsageError, "--data")


PLANTED = """
from robustflow.data.datasets import DatasetFacts
from robustflow.data.datasets.layout import Layout, LayoutDataset


class Planted(LayoutDataset):
    name = "planted"
    facts = DatasetFacts(title="Planted", layout="frames/a/1.png, flow/a/1.flo")
    layout = Layout("{kind}/{scene}/{n}.png", "flow/{scene}/{n}.flo", "{scene}/{n}", "{scene}")
    options = {"kind": ("frames", "pictures")}
"""


def test_a_dataset_is_planted_by_one_file_and_a_line_in_the_registry(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "planted_dataset.py").write_text(PLANTED)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(DATASETS, "_targets", dict(DATASETS._targets), raising=False)
    DATASETS.add("planted", "planted_dataset:Planted")
    for number in (1, 2, 3):
        picture(tmp_path / "data/frames/a" / f"{number}.png")
    for number in (1, 2):
        flow(tmp_path / "data/flow/a" / f"{number}.flo")
    dataset = load_dataset("planted", tmp_path / "data")
    assert [(sample.key, sample.group) for sample in dataset] == [("a/1", "a"), ("a/2", "a")]
    assert pickle.loads(pickle.dumps(dataset)).around("a/1", 5) == range(3)
    refusal(lambda: load_dataset("planted", tmp_path / "data", kind="films"), UsageError, "kind")


def check_frames_around(dataset: Clips, key: str, files: list[Path], place: int) -> None:
    """Assert that the frames around the pair at index `place` of a sequence are those of `files`, in order."""
    assert has_clips(dataset)
    before, after = place, len(files) - place - 2
    assert dataset.around(key, 100) == range(-before, after + 2)
    assert dataset.around(key, 1) == range(-min(before, 1), 2 + min(after, 1))
    for offset in dataset.around(key, 100):
        assert dataset.frame_files(key, [offset]) == [files[place + offset]]
        assert (dataset.frame(key, offset) == read_image(files[place + offset])).all()
    assert dataset.frame_files(key, [1, -before, 0, 1]) == list(dict.fromkeys([files[0], *files[place : place + 2]]))
    for offset, frame in enumerate(dataset.load(key).frames):
        assert (frame == dataset.frame(key, offset)).all()
    assert pickle.loads(pickle.dumps(dataset)).around(key, 100) == dataset.around(key, 100)


AROUND = {
    "sintel": ({}, sintel, "training/clean/alley_1/frame_{:04}.png", "alley_1/frame_{:04}", (1, 2, 3, 4, 5)),
    "spring": ({}, spring, "train/0001/frame_left/frame_left_{:04}.png", "0001/{:04}", (1, 2, 3, 4, 5)),
}
AROUND["spring, backwards"] = ({"direction": "BW"}, *AROUND["spring"][1:4], (5, 4, 3, 2, 1))


@pytest.mark.parametrize("name", AROUND)
def test_the_frames_around_a_pair_are_its_neighbours_in_the_sequence(tmp_path: Path, name: str) -> None:
    options, make, frame, key, numbers = AROUND[name]
    if make is spring:
        pytest.importorskip("h5py", reason="needs the h5 extra")
    make(tmp_path, frames=5)
    dataset, files = load_dataset(make.__name__, tmp_path, **options), [tmp_path / frame.format(n) for n in numbers]
    for place in range(4):
        check_frames_around(dataset, key.format(numbers[place]), files, place)


def test_kitti_and_middlebury_give_the_frames_of_their_extensions(tmp_path: Path) -> None:
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
    check_frames_around(dataset, "000003", files, 3)
    assert dataset.around("000007", 5) == range(2)
    middlebury(tmp_path)
    dataset, files = load_dataset("middlebury", tmp_path), sorted((tmp_path / "other-data/Venus").iterdir())
    check_frames_around(dataset, "Venus", files, 3)
    assert dataset.around("Urban2", 5) == range(2)
    picture(files[2], height=HEIGHT + 1)
    refusal(lambda: dataset.frame("Venus", -1), DataError, files[2])


@pytest.mark.parametrize("step", [1, 3])
def test_frames_and_videos_of_a_user_give_the_frames_around_a_pair(tmp_path: Path, step: int) -> None:
    for number in range(1, 12):
        picture(tmp_path / "frames/walk" / f"{number}.png")
    for number in range(1, 5):
        picture(tmp_path / "frames/still" / f"{number}.png")
    files = [tmp_path / "frames/walk" / f"{number}.png" for number in range(1, 12, step)]
    check_frames_around(load_dataset("folder", tmp_path / "frames", step=step), f"walk/{1 + step}", files, 1)
    clips.clip(tmp_path / "walk.mp4", 12, fps=25)
    dataset, every = (load_dataset("folder", tmp_path / "walk.mp4", step=each) for each in (step, 1))
    frames = [every.load(f"{index:06d}").frames[0] for index in range(11)] + [every.load("000010").frames[1]]
    keys = dataset.keys()
    for key in [*keys, *reversed(keys)]:
        index, there = int(key), dataset.around(key, 2)
        assert (there.start, there.stop) == (-min(2, index // step), min(3, (11 - index) // step) + 1)
        for offset in there:
            np.testing.assert_array_equal(dataset.frame(key, offset), frames[index + offset * step])

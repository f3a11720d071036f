"""Test a user's own frames as a dataset: images, folders of images, and videos."""

import os
import pickle
from itertools import islice
from pathlib import Path

import av
import numpy as np
import pytest

from robustflow.core.errors import DataError, UsageError
from robustflow.data.datasets import Dataset, load_dataset
from robustflow.data.video.reader import VideoReader, upright
from robustflow.media.images import read_image
from tests.data.video.videos import video, write_video
from tests.refusals import refusal

from .layouts import picture


def refused(root: Path, culprit: Path, error: type[Exception] = DataError, **options: object) -> None:
    refusal(lambda: load_dataset("folder", root, **options), error, culprit)


def test_folder_gives_frames_in_natural_order(tmp_path: Path) -> None:
    for number in (1, 2, 9, 10, 11):
        picture(tmp_path / f"frame{number}.png")
    (tmp_path / "notes.txt").write_text("no frame")
    (tmp_path / ".frame0.png").write_bytes(b"hidden")
    dataset = load_dataset("folder", tmp_path, gaps="keep")
    assert isinstance(dataset, Dataset)
    assert dataset.keys() == ["frame1", "frame2", "frame9", "frame10"]
    sample = dataset.load("frame9")
    np.testing.assert_array_equal(sample.frames[1], read_image(tmp_path / "frame10.png"))
    assert sample.flow is None
    assert not dataset.has_flow
    assert dataset.load("frame1").group == dataset.load("frame10").group == "frames", "one sequence, one group"
    dataset = load_dataset("folder", tmp_path, step=3, gaps="keep")
    assert dataset.keys() == ["frame1", "frame2"]
    assert [path.name for path in dataset.files("frame2")] == ["frame2.png", "frame11.png"]


def test_folder_of_folders_gives_the_pairs_of_each_subfolder(tmp_path: Path) -> None:
    for clip, height in (("clip10", 6), ("clip9", 12)):
        for number in (1, 2, 3):
            picture(tmp_path / clip / f"{number}.png", height)
    dataset = load_dataset("folder", tmp_path)
    assert dataset.keys() == ["clip9/1", "clip9/2", "clip10/1", "clip10/2"]
    assert dataset.load("clip10/2").group == "clip10"


@pytest.mark.parametrize("name", [b"caf\xe9.png", b"caf\xe9/1.png"])
def test_a_name_that_is_not_utf_8_is_refused(tmp_path: Path, name: bytes) -> None:
    """A zip file of an older Windows contains such names."""
    path = tmp_path / os.fsdecode(name)
    path.parent.mkdir(exist_ok=True)
    picture(tmp_path / "ascii.png")
    (tmp_path / "ascii.png").rename(path)
    refused(tmp_path, path)


@pytest.mark.parametrize(("dataset", "name"), [("folder", "clip\\1.png"), ("sintel", "training\\clean\\a\\1.png")])
def test_files_named_like_paths_of_windows_are_refused(tmp_path: Path, dataset: str, name: str) -> None:
    """Some programs unpack an archive made on Windows into one folder."""
    for number in (1, 2):
        picture(tmp_path / name.replace("1", str(number)))
    refusal(lambda: load_dataset(dataset, tmp_path), DataError, tmp_path / name)


def test_folder_without_a_valid_sequence_is_refused(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    refused(tmp_path, tmp_path)
    picture(tmp_path / "b.png", height=9)
    refused(tmp_path, tmp_path / "b.png")
    picture(tmp_path / "b.png")
    refused(tmp_path, tmp_path, step=2)
    picture(tmp_path / "b.bmp")
    refused(tmp_path, tmp_path)
    (tmp_path / "b.bmp").write_bytes(b"")
    (tmp_path / "b.png").unlink()
    refused(tmp_path, tmp_path / "b.bmp")


def decoded(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [upright(frame, path) for frame in container.decode(video=0)]


VIDEOS = {
    "b_frames.mp4": {"gop": 12, "bf": "3"},
    "open_gop.mkv": {"gop": 12, "x264-params": "open-gop=1:bframes=3"},
    "one_key.mp4": {"gop": 1000},
    "index_first.mp4": {"gop": 12, "index_first": True},
    "old.avi": {"gop": 10, "codec": "mpeg4"},
    "stream.ts": {"gop": 15, "codec": "mpeg2video"},
}


@pytest.mark.parametrize("name", VIDEOS)
def test_frames_by_number_equal_plain_decoding(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_video(path, 60, **VIDEOS[name])
    expected = decoded(path)
    reader = VideoReader(path)
    assert len(reader) == len(expected)
    order = [0, 1, 2, 5, 30, 29, 59, 0, 58, 37, 38, 12, 11, 13, 59]
    for index in [*order, *range(len(expected))]:
        np.testing.assert_array_equal(reader.frame(index), expected[index], err_msg=f"frame {index}")


def test_video_gives_pairs_of_consecutive_frames(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    write_video(path, 20, 6)
    expected = decoded(path)
    dataset = load_dataset("folder", path, step=3)
    assert isinstance(dataset, Dataset)
    assert dataset.keys() == [f"{index:06d}" for index in range(17)]
    for key in ("000000", "000001", "000016", "000004"):
        sample = pickle.loads(pickle.dumps(dataset)).load(key) if key == "000004" else dataset.load(key)
        np.testing.assert_array_equal(sample.frames[0], expected[int(key)])
        np.testing.assert_array_equal(sample.frames[1], expected[int(key) + 3])
    assert sample.group == "clip"
    assert dataset.files("000004") == [path]
    for key in ("000017", "4", "x", "-00001"):
        refusal(lambda key=key: dataset.load(key), UsageError, key)
    refused(path, path, step=20)
    refused(tmp_path, tmp_path)


def test_a_pickled_reader_carries_no_frame_and_no_open_file(tmp_path: Path) -> None:
    write_video(tmp_path / "clip.mp4", 20, 6)
    reader = VideoReader(tmp_path / "clip.mp4")
    frame = reader.frame(7)
    data = pickle.dumps(reader)
    assert len(data) < frame.nbytes / 2
    np.testing.assert_array_equal(pickle.loads(data).frame(7), frame)
    reader.frame(7)[:] = 0
    np.testing.assert_array_equal(reader.frame(7), frame)


@pytest.mark.parametrize("name", VIDEOS)
def test_a_video_that_lacks_frames_is_refused(tmp_path: Path, name: str) -> None:
    write_video(tmp_path / name, 60, **VIDEOS[name])
    whole = (tmp_path / name).read_bytes()
    for end in (len(whole) // 2 + 7, len(whole) * 9 // 10 + 7, len(whole) - 100):
        (tmp_path / name).write_bytes(whole[:end])
        try:
            reader = VideoReader(tmp_path / name)
            assert (
                len([reader.frame(index) for index in range(len(reader))]) == 60
            )  # cut in the index behind the frames
        except DataError as error:
            assert error.culprit == str(tmp_path / name)  # noqa: PT017


def test_a_damaged_video_is_refused(tmp_path: Path) -> None:
    """With default settings, FFmpeg conceals a changed byte with earlier content."""
    write_video(tmp_path / "a.mp4", 30, 10, crf="5")
    whole, expected = (tmp_path / "a.mp4").read_bytes(), decoded(tmp_path / "a.mp4")
    start, changed, decoded_frames = whole.index(b"mdat") + 900, 0, 0
    for at in range(start, whole.rindex(b"moov") - 100, 97):
        (tmp_path / "b.mp4").write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        try:
            shown = decoded(tmp_path / "b.mp4")
        except av.error.FFmpegError:
            continue
        if len(shown) == len(expected) and all((a == b).all() for a, b in zip(shown, expected, strict=True)):
            continue
        changed += 1
        try:
            reader = VideoReader(tmp_path / "b.mp4")
            for index in range(len(reader)):
                reader.frame(index)
        except DataError:
            continue
        decoded_frames += 1
    assert changed > 20
    assert decoded_frames < changed / 4


def test_frames_of_real_videos_equal_plain_decoding(shared) -> None:
    order = [43, 40, 41, 42, 3, 0, 1, 2]
    for path in sorted(shared("data/video").iterdir()):
        with av.open(str(path)) as container:
            frames = enumerate(islice(container.decode(video=0), 44))
            expected = {index: upright(frame, path) for index, frame in frames if index in order}
        reader = VideoReader(path)
        for index in order:
            np.testing.assert_array_equal(reader.frame(index), expected[index])


def test_start_and_stop_select_a_part_of_a_video(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    write_video(path, 50, 6)  # 25 frames per second
    expected = decoded(path)
    for start, stop in ((10, 15), ("0.4s", "0.6s"), ("0:00.4", "15")):
        dataset = load_dataset("folder", path, start=start, stop=stop)
        assert dataset.keys() == ["000010", "000011", "000012", "000013"], (start, stop)
        np.testing.assert_array_equal(dataset.load("000013").frames[1], expected[14])
        assert list(dataset.around("000013", 5)) == [-3, -2, -1, 0, 1]
    assert load_dataset("folder", path, start="1.9s").keys() == ["000048"]
    for wrong in ("x", -1, "1:2:3:4", "1:61", 2.5, True):
        refused(path, "start", UsageError, start=wrong)
    refused(path, path, start="9s")


def test_start_and_stop_select_a_part_of_a_video_of_variable_frame_rate(tmp_path: Path) -> None:
    """Times refer to the frames' timestamps, not to multiples of a frame interval."""
    images = [np.full((48, 64, 3), 40 * index, np.uint8) for index in range(6)]
    path = video(tmp_path / "a.mp4", images, times=[0, 1, 2, 30, 31, 32])
    assert load_dataset("folder", path, start="0.5s").keys() == ["000003", "000004"]
    refused(path, path, start=2, stop=4)  # a gap of the whole video
    assert len(load_dataset("folder", path, gaps="keep").keys()) == 5


def test_start_and_stop_select_a_part_of_a_folder_of_frames(tmp_path: Path) -> None:
    for number in range(6):
        picture(tmp_path / f"{number}.png")
    assert load_dataset("folder", tmp_path, start=2, stop=5).keys() == ["2", "3"]
    refused(tmp_path, "start", UsageError, start="1s")

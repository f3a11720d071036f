"""User files are either supported or rejected with a single clear message."""

import ctypes
import struct
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.data.datasets import load_dataset
from robustflow.data.video.codec import rgb_to_i420
from robustflow.data.video.reader import VideoReader
from robustflow.data.video.source import PictureFolder, VideoFile
from robustflow.media.images import write_image
from tests.refusals import refusal

from . import clips
from .videos import video


def test_video_with_sound_is_read(tmp_path):
    frames = clips.frames(12)
    source = VideoFile(video(tmp_path / "a.mp4", frames, sound=True))
    assert (source.count, source.size, source.fps) == (12, (48, 64), 30)
    assert VideoFile(video(tmp_path / "odd.mkv", clips.frames(5, 47, 63), pixels="yuv444p")).size == (47, 63)
    read = list(source.frames())
    assert len(read) == 12
    distances = [[np.abs(one.astype(int) - other).mean() for other in frames] for one in read]
    assert [int(np.argmin(row)) for row in distances] == list(range(12))


def test_a_video_is_neither_darker_nor_brighter_than_its_luma(tmp_path):
    path = video(tmp_path / "a.mp4", clips.frames(3))
    with av.open(str(path)) as container:
        expected = [picture.to_ndarray()[:48] for picture in container.decode(video=0)]
    for frame, luma in zip(VideoFile(path).frames(), expected, strict=True):
        assert np.abs(rgb_to_i420(frame)[:48].astype(int) - luma).mean() < 0.1


@pytest.fixture
def without_vector_code():
    """Return a function that makes FFmpeg use only C code until the end of the test."""
    if sys.platform != "linux":
        pytest.skip("reads the path of FFmpeg's library from /proc")
    used = next(line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libavutil" in line)
    force = ctypes.CDLL(used).av_force_cpu_flags
    yield lambda: force(0)
    force(-1)


@pytest.mark.parametrize("pixels", ["yuv420p", "yuvj420p", "yuv422p", "yuv444p", "yuv420p10le"])
def test_frames_are_the_same_without_vector_code(tmp_path, without_vector_code, pixels):
    source = VideoFile(video(tmp_path / "a.mkv", clips.frames(3), pixels=pixels))
    frames = list(source.frames())
    without_vector_code()
    assert np.array_equal(list(source.frames()), frames)


@pytest.mark.parametrize(("rotation", "quarter"), [(90, 1), (180, 2), (270, 3)])
def test_rotation_is_applied_in_order_by_number_and_in_a_data_set(tmp_path, rotation, quarter):
    """For a video recorded with a phone, a run uses the same frames that a video player shows."""
    image = np.zeros((32, 64, 3), np.uint8)
    image[:8, :16] = 255
    expected = np.rot90(image, quarter)
    path = video(tmp_path / "a.mp4", [image] * 3, rotation=rotation)
    reader, dataset = VideoReader(path), load_dataset("folder", path, gaps="keep")
    for frame in (next(VideoFile(path).frames()), reader.frame(2), reader.frame(0), reader.frame(0)):
        assert frame.shape == expected.shape
        assert np.abs(frame.astype(int) - expected).mean() < 4
    assert dataset.load(dataset.keys()[0]).frames[0].shape == expected.shape


@pytest.mark.parametrize(
    ("matrix", "turned"),
    [
        ((-1, 0, 0, 1), lambda image: image[:, ::-1]),
        ((1, 0, 0, -1), lambda image: image[::-1]),
        ((0, 1, 1, 0), lambda image: image.transpose(1, 0, 2)),
        ((0, 1, -1, 0), lambda image: np.rot90(image, -1)),
    ],
)
def test_a_mirrored_video_is_read_as_players_show_it(tmp_path, matrix, turned):
    image = np.zeros((32, 64, 3), np.uint8)
    image[:8, :16] = 255
    path = video(tmp_path / "a.mp4", [image] * 3)
    data = path.read_bytes()
    a, b, c, d = (value << 16 for value in matrix)
    identity = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    at = data.index(identity, data.index(b"tkhd"))
    path.write_bytes(data[:at] + struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30) + data[at + len(identity) :])
    frame = VideoReader(path).frame(0)
    assert frame.shape == turned(image).shape
    assert np.abs(frame.astype(int) - turned(image)).mean() < 4


def test_a_turn_that_is_not_a_quarter_is_refused(tmp_path):
    path = video(tmp_path / "a.mp4", [np.zeros((32, 64, 3), np.uint8)] * 3, rotation=30)
    refusal(lambda: VideoReader(path).frame(0), DataError, path)


def test_ten_bit_video_is_converted_to_eight_bits(tmp_path):
    frames = clips.frames(6)
    source = VideoFile(video(tmp_path / "a.mkv", frames, pixels="yuv420p10le"))
    assert source.describe()["pixels"] == "yuv420p10le"
    eight = list(VideoFile(video(tmp_path / "b.mkv", frames)).frames())
    for ten, other in zip(source.frames(), eight, strict=True):
        assert ten.dtype == np.uint8
        assert np.abs(ten.astype(int) - other).mean() < 3


def test_variable_frame_rate_needs_a_decision(tmp_path):
    path = video(tmp_path / "a.mp4", clips.frames(8), times=[0, 1, 2, 4, 5, 9, 10, 11])
    refusal(lambda: VideoFile(path), DataError, path)
    source = VideoFile(path, evenly=True)
    assert len(list(source.frames())) == source.count == 8
    assert source.describe()["variable_rate"] is True


def test_phone_video_of_uneven_frame_rate_is_read(shared):
    path = shared("data", "video", "handheld_video-10.m4v")
    refusal(lambda: VideoFile(path), DataError, path)
    source = VideoFile(path, evenly=True)
    assert sum(1 for _ in source.frames()) == source.count


def read(path):
    return list(VideoFile(path).frames())


def sound_only(path, codec):
    with av.open(str(path), "w") as container:
        audio = container.add_stream(codec, rate=44100, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.int16), format="s16", layout="mono")
        frame.sample_rate = 44100
        container.mux(audio.encode(frame))
        container.mux(audio.encode(None))


def unknown_codec(path):
    video(path, clips.frames(1))
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_MPEG4/ISO/XVC"))


PLAYLIST = b"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nreal.mp4\n#EXT-X-ENDLIST\n"
NO_VIDEOS = {
    "empty.mp4": lambda path: path.write_bytes(b""),
    "text.mp4": lambda path: path.write_bytes(b"no video at all\n" * 99),
    "image.mp4": lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(99)),
    "playlist.mp4": lambda path: path.write_bytes(PLAYLIST),
    "concatenation.mp4": lambda path: path.write_bytes(b"ffconcat version 1.0\nfile real.mp4\n"),
    "sound.wav": lambda path: sound_only(path, "pcm_s16le"),
    "sound.mp4": lambda path: sound_only(path, "aac"),
    "codec.mkv": unknown_codec,
    "missing.mp4": lambda path: None,
}


@pytest.mark.parametrize("name", NO_VIDEOS)
def test_file_without_a_video_is_refused_and_lists_of_files_are_not_opened(tmp_path, name):
    """FFmpeg detects formats by content: it would read a list of files whatever the file name."""
    video(tmp_path / "real.mp4", clips.frames(3))
    NO_VIDEOS[name](tmp_path / name)
    refusal(lambda: read(tmp_path / name), DataError, tmp_path / name)


def test_folder_without_images_or_with_images_of_different_sizes_is_refused(tmp_path):
    refusal(lambda: PictureFolder(tmp_path), DataError, tmp_path)
    folder = clips.folder(tmp_path / "seq", 3)
    write_image(folder / "000004.png", clips.frames(1, 50, 64)[0])
    refusal(lambda: list(PictureFolder(folder).frames()), DataError, folder / "000004.png")


def test_pictures_without_leading_zeros_are_in_the_order_of_their_numbers(tmp_path):
    for number in (1, 2, 10):
        write_image(tmp_path / f"{number}.png", np.full((4, 6, 3), number, np.uint8))
    (tmp_path / "._1.png").write_bytes(b"written by macOS")
    (tmp_path / "3.png").mkdir()
    assert [int(frame[0, 0, 0]) for frame in PictureFolder(tmp_path).frames()] == [1, 2, 10]

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
from tests.refusals import refused

from . import clips
from .videos import video


def test_video_with_sound_is_read(tmp_path):
    frames = clips.frames(12)
    source = VideoFile(video(tmp_path / "a.mp4", frames, sound=True))
    assert (source.count, source.size, source.fps) == (12, (48, 64), 30)
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
    reader, dataset = VideoReader(path), load_dataset("folder", path)
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
    with pytest.raises(DataError, match="only multiples of 90 degrees are supported"):
        VideoReader(path).frame(0)


def test_ten_bit_video_is_converted_to_eight_bits(tmp_path):
    frames = clips.frames(6)
    source = VideoFile(video(tmp_path / "a.mkv", frames, pixels="yuv420p10le"))
    assert source.describe()["pixels"] == "yuv420p10le"
    eight = list(VideoFile(video(tmp_path / "b.mkv", frames)).frames())
    for ten, other in zip(source.frames(), eight, strict=True):
        assert ten.dtype == np.uint8
        assert np.abs(ten.astype(int) - other).mean() < 3


def test_video_of_odd_size_is_read(tmp_path):
    frames = clips.frames(5, 47, 63)
    source = VideoFile(video(tmp_path / "a.mkv", frames, pixels="yuv444p"))
    assert source.size == (47, 63)


def test_variable_frame_rate_needs_a_decision(tmp_path):
    frames = clips.frames(8)
    path = video(tmp_path / "a.mp4", frames, times=[0, 1, 2, 4, 5, 9, 10, 11])
    with pytest.raises(
        DataError, match=r"variable frame rate \(33.3 to 133.3 ms .*robustflow prepare gopro-fc the option --fps"
    ):
        VideoFile(path)
    source = VideoFile(path, evenly=True)
    assert len(list(source.frames())) == source.count == 8
    assert source.describe()["variable_rate"] is True


def test_rounded_times_are_a_constant_rate(tmp_path):
    """Matroska rounds times to milliseconds: 33, 34 and 33 ms correspond to 30 frames per second."""
    source = VideoFile(video(tmp_path / "a.mkv", clips.frames(10)))
    assert not source.variable


def test_phone_video_of_uneven_frame_rate_is_read(shared):
    path = shared("data", "video", "handheld_video-10.m4v")
    with pytest.raises(DataError, match="variable frame rate"):
        VideoFile(path)
    source = VideoFile(path, evenly=True)
    assert sum(1 for _ in source.frames()) == source.count


@pytest.mark.parametrize("options", [{}, {"movflags": "faststart"}], ids=["index last", "index first"])
def test_truncated_video_is_refused(tmp_path, options):
    path = video(tmp_path / "a.mp4", clips.frames(40, 96, 128), options=options)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(DataError, match=r"damaged|cut short|can be decoded|not a readable video"):
        list(VideoFile(path).frames())


def test_video_with_damage_inside_is_refused(tmp_path):
    """If part of the file is garbage, frames may be missing; their number is checked."""
    path = video(tmp_path / "a.mp4", clips.frames(30, 96, 128), options={"movflags": "faststart"})
    data = bytearray(path.read_bytes())
    start = data.find(b"mdat") + 4
    data[start + 2000 : start + 12000] = b"\xff" * len(data[start + 2000 : start + 12000])
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"damaged|can be decoded"):
        list(VideoFile(path).frames())


@pytest.fixture(params=[VideoFile, VideoReader])
def read(request):
    """Either of the two readers of videos."""
    return request.param


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not a readable video"),
        (b"no video at all\n" * 99, "not a readable video"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), "not a readable video"),
        (b"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nreal.mp4\n#EXT-X-ENDLIST\n", "not a readable video"),
        (b"ffconcat version 1.0\nfile real.mp4\n", "an unsupported container"),
    ],
    ids=["empty", "text", "image", "playlist", "concatenation"],
)
def test_file_without_a_video_is_refused_and_lists_of_files_are_not_opened(tmp_path, read, content, says):
    """FFmpeg detects formats by content: it would read a list of files whatever the file name."""
    video(tmp_path / "real.mp4", clips.frames(3))
    (tmp_path / "a.mp4").write_bytes(content)
    with refused(DataError, f"a.mp4: .*{says}"):
        read(tmp_path / "a.mp4")


@pytest.mark.parametrize(
    ("name", "codec", "says"),
    [("a.wav", "pcm_s16le", "an unsupported container"), ("a.mp4", "aac", "no video stream")],
)
def test_file_with_sound_only_is_refused(tmp_path, read, name, codec, says):
    with av.open(str(tmp_path / name), "w") as container:
        audio = container.add_stream(codec, rate=44100, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.int16), format="s16", layout="mono")
        frame.sample_rate = 44100
        container.mux(audio.encode(frame))
        container.mux(audio.encode(None))
    with refused(DataError, says):
        read(tmp_path / name)


def test_missing_video_is_refused(tmp_path, read):
    with refused(DataError, "no such file"):
        read(tmp_path / "a.mp4")


def test_folder_of_frames_of_different_sizes_is_refused(tmp_path):
    folder = clips.folder(tmp_path / "seq", 3)
    write_image(folder / "000004.png", clips.frames(1, 50, 64)[0])
    with pytest.raises(DataError, match=r"50x64.*48x64"):
        list(PictureFolder(folder).frames())


def test_pictures_without_leading_zeros_are_in_the_order_of_their_numbers(tmp_path):
    for number in (1, 2, 10):
        write_image(tmp_path / f"{number}.png", np.full((4, 6, 3), number, np.uint8))
    (tmp_path / "._1.png").write_bytes(b"written by macOS")
    (tmp_path / "3.png").mkdir()
    assert [int(frame[0, 0, 0]) for frame in PictureFolder(tmp_path).frames()] == [1, 2, 10]


def test_folder_without_images_is_refused(tmp_path):
    with pytest.raises(DataError, match="contains no images"):
        PictureFolder(tmp_path)


def test_video_with_a_damaged_codec_is_refused_in_one_sentence(tmp_path):
    path = video(tmp_path / "a.mkv", clips.frames(1))
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_MPEG4/ISO/XVC"))
    with pytest.raises(DataError, match=r"a\.mkv: not a readable video \(its codec is unknown\)"):
        VideoFile(path)

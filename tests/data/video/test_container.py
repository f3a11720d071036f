"""The video of a file is chosen by its size; alpha, HDR and damage are not passed over in silence."""

import warnings
from contextlib import suppress
from fractions import Fraction

import av
import numpy as np
import pytest

from robustflow.core.errors import DataError
from robustflow.data.video.reader import VideoReader

from ...refusals import refusal
from . import clips
from .videos import video, write_video

ENCODERS = {
    "a.mp4": ("libx264", True),
    "a.mkv": ("libx264", False),
    "a.webm": ("libvpx-vp9", False),
    "a.avi": ("mpeg4", False),
    "a.ts": ("libx264", False),
}


def of_size(path, count, sizes, codecs=("libx264", "libx264"), cover=False):
    """Write one video stream of each size; the first is a cover picture if `cover`."""
    with av.open(str(path), "w") as container:
        streams = []
        for (height, width), codec in zip(sizes, codecs, strict=True):
            stream = container.add_stream(codec, rate=25)
            stream.height, stream.width = height, width
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            streams.append(stream)
        if cover:
            streams[0].disposition = av.stream.Disposition.attached_pic
        for index in range(count):
            for stream in streams[cover and index > 0 :]:
                image = np.full((stream.height, stream.width, 3), 10 * index, np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=stream.pix_fmt)
                frame.pts, frame.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("name", "sizes", "codecs", "cover"),
    [
        ("a.mkv", [(24, 32), (48, 64)], ("libx264", "libx264"), False),
        ("a.mp4", [(24, 32), (48, 64)], ("mjpeg", "libx264"), False),
        ("a.mp4", [(48, 64), (24, 32)], ("libx264", "libx264"), False),
        ("a.mp4", [(96, 128), (48, 64)], ("mjpeg", "libx264"), True),
    ],
)
def test_the_largest_video_is_read_and_no_cover_picture(tmp_path, name, sizes, codecs, cover):
    reader = VideoReader(of_size(tmp_path / name, 12, sizes, codecs, cover))
    assert len(reader) == 12
    assert [reader.frame(index).shape for index in (0, 11, 5)] == [(48, 64, 3)] * 3
    assert reader.frame(11).mean() > reader.frame(0).mean() + 90


def test_two_videos_of_the_same_size_are_refused(tmp_path):
    path = of_size(tmp_path / "a.mkv", 3, [(24, 32), (24, 32)])
    refusal(lambda: VideoReader(path), DataError, path)


def with_alpha(path, codec, pixels, opacity):
    image = np.full((48, 64, 4), (90, 60, 30, 255), np.uint8)
    image[3, 4, 3] = opacity
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width, stream.pix_fmt = 48, 64, pixels
        for index in range(3):
            frame = av.VideoFrame.from_ndarray(image, format="rgba").reformat(format=pixels)
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path, image[..., :3]


def test_alpha_of_a_video_is_dropped_only_if_opaque(tmp_path):
    path, image = with_alpha(tmp_path / "a.mov", "qtrle", "argb", 255)
    np.testing.assert_array_equal(VideoReader(path).frame(1), image)
    path, _ = with_alpha(tmp_path / "b.mov", "qtrle", "argb", 254)
    refusal(lambda: VideoReader(path).frame(1), DataError, path)


def test_alpha_that_the_decoder_ignores_is_refused(tmp_path):
    path, _ = with_alpha(tmp_path / "a.webm", "libvpx-vp9", "yuva420p", 254)
    refusal(lambda: VideoReader(path), DataError, path)


@pytest.mark.parametrize(("transfer", "named"), [("1", None), ("16", "PQ"), ("18", "HLG")])
def test_hdr_is_named(tmp_path, transfer, named):
    write_video(tmp_path / "a.mp4", 3, 3, color_trc=transfer)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        reader = VideoReader(tmp_path / "a.mp4")
    assert (reader.transfer or "").split()[:1] == ([named] if named else [])
    assert [named in str(warning.message) for warning in caught] == ([True] if named else [])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder, encoded = tmp_path_factory.mktemp("videos"), {}
    for name, (codec, index_first) in ENCODERS.items():
        write_video(folder / name, 40, 10, codec, index_first)
        encoded[name] = (folder / name).read_bytes()
    for name, codec, pixels in (("a.gif", "gif", "rgb8"), ("a.y4m", "wrapped_avframe", "yuv420p")):
        encoded[name] = video(folder / name, clips.frames(20), pixels=pixels, codec=codec).read_bytes()
    return encoded


@pytest.mark.parametrize("name", [*ENCODERS, "a.gif", "a.y4m"])
@pytest.mark.parametrize("place", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("damage", ["cut", "zero", "noise", "gap"])
def test_part_of_a_damaged_video_is_not_taken_for_the_whole(tmp_path, whole, name, place, damage):
    """It is refused when it is opened, or has all its frames, of which those that are damaged are refused."""
    if name == "a.gif" and damage in ("noise", "gap"):
        pytest.skip("the blocks of a GIF can fit together again, so that two images become one")
    path, data = tmp_path / name, bytearray(whole[name])
    path.write_bytes(data)
    count = len(VideoReader(path))
    at, length = int(len(data) * place), max(300, len(data) // 50)
    if damage == "cut":
        del data[at | 1 :]
    elif damage == "gap":
        del data[at : at + length]
    else:
        lost = np.random.default_rng(at).integers(0, 256, length) * (damage == "noise")
        data[at : at + length] = lost.astype(np.uint8).tobytes()
    path.write_bytes(data)
    frames = []
    with suppress(DataError):
        frames = list(range(len(VideoReader(path))))
    assert len(frames) in (0, count)

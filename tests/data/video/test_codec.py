"""Encoding, decoding, and colour conversion compared with the standard and with FFmpeg."""

import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robustflow.core.errors import DataError
from robustflow.data.video.clip import ClipReader, read_header, read_packets, read_pictures, write_clip
from robustflow.data.video.codec import Decoder, Encoder, abr, crf, even_size, i420_to_rgb, lossless, rgb_to_i420
from tests.refusals import refusal

from . import clips


@settings(max_examples=15, deadline=None)
@given(st.integers(17, 40), st.integers(17, 40), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_lossless_is_lossless_at_any_size(tmp_path_factory, height, width, count, seed):
    rows, columns = even_size(height, width)
    noise = np.random.default_rng(seed).integers(0, 256, (count, rows * 3 // 2, columns), np.uint8)
    path = tmp_path_factory.mktemp("clip") / "a.mp4"
    clip = write_clip(path, noise, (height, width), Fraction(960), lossless("ultrafast"))
    read = list(read_pictures(clip))
    assert [index for index, _ in read] == list(range(count))
    assert all((picture == noise[index]).all() for index, picture in read)


def test_frames_larger_than_the_encoder_accepts_are_refused():
    assert Encoder(16, 16384, Fraction(30), lossless("ultrafast")).header
    refusal(lambda: Encoder(16, 16386, Fraction(30), lossless("ultrafast")), DataError, "frames of 16386x16")


@pytest.mark.parametrize("encoding", [crf(30), abr(200_000)])
def test_encoding_in_memory_is_encoding_to_a_file(tmp_path, encoding):
    """The transcoded stream is never written to a file; its frames are identical to those of a file written by
    FFmpeg.
    """
    count = 40
    pictures = clips.pictures(count)
    encoder = Encoder(48, 64, Fraction(960), encoding)
    decoder = Decoder(encoder.header, 48, 64)
    direct = list(decoder.decode(encoder.encode(enumerate(pictures))))
    clip = write_clip(tmp_path / "a.mp4", pictures, (48, 64), Fraction(960), encoding)
    with av.open(str(clip.path)) as container:
        filed = [frame.to_ndarray() for frame in container.decode(video=0)]
    assert [index for index, _ in direct] == list(range(count))
    assert len(filed) == count
    assert all((mine == theirs).all() for (_, mine), theirs in zip(direct, filed, strict=True))


_SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "encoding", [crf(30), pytest.param(abr(200_000), marks=_SLOW), pytest.param(lossless("medium"), marks=_SLOW)]
)
def test_uninitialised_memory_does_not_change_the_encoded_bytes(encoding):
    """The stream does not depend on uninitialised memory; x264's fastest code fails this test (see `codec.EXACT`)."""
    code = f"""
import hashlib, sys
from fractions import Fraction
from robustflow.data.video.codec import Encoder
from tests.data.video.clips import pictures
encoder = Encoder(96, 128, Fraction(960), {encoding!r})
print(hashlib.sha256(b"".join(p.data for p in encoder.encode(enumerate(pictures(30, 96, 128))))).hexdigest())
"""
    root = Path(__file__).resolve().parents[3]
    results = set()
    for perturb in ("1", "200"):
        environment = os.environ | {"MALLOC_PERTURB_": perturb, "PYTHONPATH": str(root)}
        done = subprocess.run([sys.executable, "-c", code], cwd=root, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        results.add(done.stdout)
    assert len(results) == 1


def test_reader_gives_any_frame_in_any_order(tmp_path):
    clip = clips.clip(tmp_path / "a.mp4", 60)
    pictures = clips.pictures(60)
    reader = ClipReader(clip, keep=4)
    for index in (10, 11, 12, 3, 59, 58, 0, 30, 28, 10):
        assert (reader.picture(index) == pictures[index]).all()
    with pytest.raises(IndexError):
        reader.picture(60)


def test_reader_seeks_across_groups_of_pictures(tmp_path):
    clip = clips.clip(tmp_path / "a.mp4", 40, encoding=lossless("ultrafast", every_frame=True))
    starts = [next(packet.index for packet in read_packets(clip, start)) for start in (0, 17, 39)]
    assert starts == [0, 17, 39]
    assert (ClipReader(clip).picture(17) == clips.pictures(40)[17]).all()


def test_reader_of_a_different_file_than_prepared_is_refused(tmp_path):
    clip = clips.clip(tmp_path / "a.mp4", 20)
    data = clip.path.read_bytes()
    clip.path.write_bytes(data[: len(data) // 2])
    refusal(lambda: list(read_pictures(clip)), DataError, clip.path)
    clip.path.unlink()
    refusal(lambda: read_header(clip), DataError, clip.path)


def test_no_frames_is_an_error_and_leaves_no_file(tmp_path):
    refusal(lambda: write_clip(tmp_path / "a.mp4", [], (48, 64), Fraction(960), lossless()), DataError, "a.mp4")
    assert not (tmp_path / "a.mp4").exists()


RGB = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(lambda size: arrays(np.uint8, (*size, 3)))


def reference_yuv(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert to BT.601 limited range as defined, in float64, averaging chroma over 2x2 pixels; sizes must be even."""
    r, g, b = (rgb[..., c] / 255.0 for c in range(3))
    y = 0.299 * r + 0.587 * g + 0.114 * b
    cb, cr = 0.5 * (b - y) / (1 - 0.114), 0.5 * (r - y) / (1 - 0.299)
    halved = [c.reshape(c.shape[0] // 2, 2, c.shape[1] // 2, 2).mean((1, 3)) for c in (cb, cr)]
    return 16 + 219 * y, 128 + 224 * halved[0], 128 + 224 * halved[1]


def reference_rgb(y: np.ndarray, cb: np.ndarray, cr: np.ndarray) -> np.ndarray:
    y = (y.astype(float) - 16) / 219
    cb, cr = ((c.astype(float).repeat(2, 0).repeat(2, 1) - 128) / 224 for c in (cb, cr))
    r, b = y + 2 * (1 - 0.299) * cr, y + 2 * (1 - 0.114) * cb
    g = (y - 0.299 * r - 0.114 * b) / 0.587
    return np.clip(np.stack([r, g, b], -1) * 255, 0, 255)


@given(RGB)
def test_conversion_equals_the_standard(rgb):
    height, width = rgb.shape[:2]
    even = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    picture = rgb_to_i420(rgb)
    rows, columns = even.shape[:2]
    chroma = picture[rows:].reshape(2, rows // 2, columns // 2)
    y, cb, cr = reference_yuv(even)
    for mine, exact in ((picture[:rows], y), (chroma[0], cb), (chroma[1], cr)):
        assert np.abs(mine - exact).max() <= 0.5 + 0.01  # for rounding and 16-bit coefficients
    back = i420_to_rgb(picture, height, width)
    exact = reference_rgb(picture[:rows], chroma[0], chroma[1])[:height, :width]
    assert np.abs(back - exact).max() <= 0.5 + 0.02


def test_conversion_is_within_rounding_of_ffmpeg():
    frame = clips.frames(1, 96, 128)[0]
    by_ffmpeg = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format="yuv420p").to_ndarray()
    mine = rgb_to_i420(frame)
    assert np.abs(mine[:96].astype(int) - by_ffmpeg[:96]).max() <= 1
    picture = av.VideoFrame.from_ndarray(mine, format="yuv420p")
    back = picture.to_ndarray(format="rgb24").astype(int)
    assert np.abs(i420_to_rgb(mine, 96, 128) - back).max() <= 3

"""Test encoding and decoding: lossless encoding, time stamps, single-threaded use, and reproducible files."""

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

from robustflow.core.errors import DataError, UsageError
from robustflow.data.video.clip import ClipReader, read_header, read_packets, read_pictures, write_clip
from robustflow.data.video.codec import Decoder, Encoder, abr, crf, even_size, lossless

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


def test_frames_wider_than_the_encoder_accepts_are_refused():
    assert Encoder(16, 16384, Fraction(30), lossless("ultrafast")).header
    with pytest.raises(DataError, match="at most 16384 pixels per side, but the frames are 16386x16"):
        Encoder(16, 16386, Fraction(30), lossless("ultrafast"))


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
from robustflow.data.video.codec import Encoder, Encoding
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


def test_higher_crf_and_lower_rate_are_worse(tmp_path):
    pictures = clips.pictures(60, 96, 128)
    for family in ([crf(v) for v in (23, 37, 51)], [abr(v) for v in (4_000_000, 1_000_000, 250_000)]):
        errors, sizes = [], []
        for encoding in family:
            clip = write_clip(tmp_path / "a.mp4", pictures, (96, 128), Fraction(960), encoding)
            errors.append(np.mean([np.abs(p.astype(int) - pictures[i]).mean() for i, p in read_pictures(clip)]))
            sizes.append(clip.path.stat().st_size)
        assert errors == sorted(errors)
        assert sizes == sorted(sizes, reverse=True)


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
    with pytest.raises(DataError, match=r"prepare it again"):
        list(read_pictures(clip))
    clip.path.unlink()
    with pytest.raises(DataError, match=r"prepare it again"):
        read_header(clip)


def test_no_frames_is_an_error_and_leaves_no_file(tmp_path):
    with pytest.raises(DataError, match="no frames"):
        write_clip(tmp_path / "a.mp4", [], (48, 64), Fraction(960), lossless())
    assert not (tmp_path / "a.mp4").exists()


def test_invalid_codec_values_are_refused():
    for make in (lambda: crf(52), lambda: abr(0)):
        with pytest.raises(UsageError):
            make()

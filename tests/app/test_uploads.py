"""Uploads are decoded as on the command line, limited in size, and never trusted."""

from __future__ import annotations

import http.client
import struct
import zlib

import av
import numpy as np
import pytest

import robustflow as rf
from robustflow.app.sources import KEPT
from robustflow.app.uploads import MAX_CLIP_FRAMES
from robustflow.media.flow import flo_bytes
from tests.data.video import clips

from .library import direct_numbers, png

MAX_BYTES = 64 * 2**20
RNG = np.random.default_rng(0)
FRAME = np.repeat(np.repeat(RNG.integers(0, 255, (32, 48, 3)), 3, 0), 3, 1).astype(np.uint8)
OTHER = np.roll(FRAME, 2, axis=1)


def _flo(height: int, width: int, known: bool) -> bytes:
    return flo_bytes(np.zeros((height, width, 2), np.float32), np.full((height, width), known))


def _pair(**more) -> dict[str, tuple[str, bytes]]:
    return {"frame1": ("a.png", png(FRAME)), "frame2": ("b.png", png(OTHER)), **more}


@pytest.mark.parametrize("with_truth", [False, True])
def test_numbers_of_an_uploaded_pair_are_those_of_the_library(app, with_truth):
    flow = np.tile(np.array([2, 0], np.float32), (*FRAME.shape[:2], 1))
    valid = np.ones(FRAME.shape[:2], bool)
    valid[:, :2] = False
    truth = {"truth": ("gt.flo", flo_bytes(flow, valid))} if with_truth else {}
    status, found = app.upload(**_pair(**truth))
    assert (status, found["name"], found["pairs"]) == (200, "a.png, b.png", 1)
    layers = [{"name": "impulse_noise", "severity": 3}]
    result = app.preview(source=found["source"], layers=layers)[1][-1]["result"]
    flow[~valid] = 0
    expected = direct_numbers((FRAME, OTHER), (flow, valid) if with_truth else None, "impulse_noise", 3, 0, "a")
    assert result["numbers"] == {name: value and pytest.approx(value) for name, value in expected.items()}
    assert result["truth"] is with_truth


def test_preview_offers_every_pair_of_an_uploaded_clip(app, tmp_path):
    path = clips.clip(tmp_path / "drive.mp4", 6).path
    status, found = app.upload(clip=("drive.mp4", path.read_bytes()))
    assert (status, found["pairs"]) == (200, 5)
    video = rf.load_dataset("folder", path)
    for index in (4, 0):
        sample = video.load(video.keys()[index])
        result = app.preview(source=found["source"], index=index)[1][-1]["result"]
        expected = direct_numbers(sample.frames, None, "fog", 3, 0, sample.key)
        assert result["numbers"]["rcre"] == pytest.approx(expected["rcre"])
    assert app.preview(source=found["source"], index=5)[1][-1]["error"].startswith("pair 6: ")


def _claims(width: int, height: int) -> bytes:
    """A PNG of a few bytes that claims to be large."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("files", "culprit"),
    [
        ({"frame1": ("a.png", b"only text\n")}, "a.png: "),
        ({"frame1": ("a.txt", png(FRAME))}, "a.txt: "),
        ({"frame1": ("a.svg", b"<svg onload='alert(1)'/>")}, "a.svg: "),
        ({"frame1": ("a.png", png(FRAME)[:-100])}, "a.png: "),
        ({"frame1": ("a.png", b"")}, "a.png: "),
        ({"frame1": ("a.png", png(np.zeros((2161, 3840, 3), np.uint8)))}, "8.3"),
        ({"frame1": ("a.png", _claims(60000, 60000))}, "a.png: "),
        ({"frame1": ("a.png", png(FRAME[:-1]))}, "b.png: "),
        ({"truth": ("gt.flo", b"PIEH")}, "gt.flo"),
        ({"truth": ("gt.flo", _flo(9, 9, True))}, "(9, 9, 2)"),
        ({"truth": ("gt.flo", _flo(96, 144, False))}, "gt.flo: "),
        ({"truth": ("gt.npz", b"PK")}, "gt.npz: "),
        ({"truth": ("gt.png", png(FRAME))}, "gt.png"),
        ({"truth": ("gt.png", _claims(9999, 9999))}, "gt.png: 9999"),
        ({"more": ("c.png", b"")}, "files"),
        ({"clip": ("c.mp4", b"")}, "frames: "),
        (None, "frames: "),
        ({"frame2": None}, "frames: "),
    ],
)  # fmt: skip
def test_unusable_upload_is_refused_in_one_line(app, files, culprit):
    sent = {} if files is None else (_pair(truth=("gt.flo", b"")) if "more" in files else _pair()) | files
    status, answer = app.upload(**{field: file for field, file in sent.items() if file is not None})
    assert status == 400
    assert culprit in answer["error"]
    assert "\n" not in answer["error"]
    assert "/tmp" not in answer["error"]
    assert "robustflow-app" not in answer["error"]


def test_upload_of_a_clip_that_is_no_video_is_refused(app):
    status, answer = app.upload(clip=("c.mp4", b"not a video"))
    assert (status, answer["error"].partition(":")[0]) == (400, "c.mp4")


@pytest.mark.parametrize("suffix", ["mkv", "mp4"])
def test_upload_of_a_clip_of_too_many_frames_is_refused_whatever_its_container_states(app, tmp_path, suffix):
    path = tmp_path / f"long.{suffix}"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width = stream.height = 16
        for _ in range(MAX_CLIP_FRAMES + 1):
            container.mux(stream.encode(av.VideoFrame(16, 16, "yuv420p")))
        container.mux(stream.encode())
    status, answer = app.upload(clip=(path.name, path.read_bytes()))
    assert (status, answer["error"].partition(":")[0]) == (400, path.name)


def test_upload_with_a_name_longer_than_a_file_system_allows_is_read(app):
    status, found = app.upload(frame1=("🙂" * 79 + ".png", png(FRAME)), frame2=("b.png", png(OTHER)))
    assert (status, found["pairs"]) == (200, 1)
    assert found["name"].endswith("🙂.png, b.png")


@pytest.mark.parametrize("name", ["../../../etc/cron.d/x.png", "C:\\windows\\x.png", "/abs/x.png", "..\\..\\x.png"])
def test_upload_with_a_path_as_name_keeps_only_the_file_name(app, name):
    status, found = app.upload(frame1=(name.replace("\\", "\\\\"), png(FRAME)), frame2=("b.png", png(OTHER)))
    assert (status, found["name"]) == (200, "x.png, b.png")


def test_upload_with_a_too_large_length_is_refused_unread(app):
    size = str(MAX_BYTES + 1)
    status, body, _ = app.ask(
        "POST", "/upload", b"", content_length=size, content_type="multipart/form-data; boundary=b"
    )
    assert status == 413
    assert b"more than 64 MB" in body


def test_upload_without_a_length_is_refused(app):
    connection = http.client.HTTPConnection(app.host, timeout=60)
    connection.putrequest("POST", "/upload", skip_host=True)
    headers = {"Host": app.host, "X-Token": app.token, "Origin": f"http://{app.host}", "Transfer-Encoding": "chunked"}
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.putheader("Content-Type", "multipart/form-data; boundary=b")
    connection.endheaders()
    start = b'--b\r\nContent-Disposition: form-data; name="frame1"; filename="a.png"\r\n\r\n'
    piece = b"x" * 2**20
    try:
        for data in (start, *[piece] * (MAX_BYTES // len(piece) + 8)):
            connection.send(b"%x\r\n%s\r\n" % (len(data), data))
        response = connection.getresponse()  # although the body is incomplete
        assert (response.status, b"more than 64 MB" in response.read()) == (413, True)
    finally:
        connection.close()
    assert app.ask("GET", "/choices")[0] == 200


def test_oldest_upload_is_removed_when_the_space_is_full(app):
    sources = [app.upload(**_pair())[1]["source"] for _ in range(KEPT + 1)]
    assert str(KEPT) in app.preview(source=sources[0])[1][-1]["error"]
    assert "result" in app.preview(source=sources[1])[1][-1]

"""A picture whose data do not fill the size in its header is refused, without the memory that the header claims."""

from __future__ import annotations

import io
import logging
import resource
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robustflow.core.errors import DataError
from robustflow.media.flow import read_flow
from robustflow.media.images import image_size, read_image
from tests.forked import outcomes
from tests.refusals import refusal

NOISE = np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)
JPEGS = {
    "baseline": {},
    "grey": {"mode": "L"},
    "full chroma": {"quality": 95, "subsampling": 0},
    "optimised": {"optimize": True},
    "restarts": {"restart_marker_blocks": 3},
    "progressive": {"progressive": True},
    "progressive with restarts": {"progressive": True, "restart_marker_rows": 1},
}
TIFFS = ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits")


def encoded(kind: str, mode: str = "RGB", frame: np.ndarray = NOISE, **options) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(frame).convert(mode).save(buffer, kind, **options)
    return buffer.getvalue()


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(height: int, width: int, pixels: bytes, before: bytes = b"", after: bytes = b"", bits: int = 8) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + before + chunk(b"IDAT", pixels) + after + chunk(b"IEND", b"")


def rows(dtype: str = "u1") -> bytes:
    frame = NOISE if dtype == "u1" else NOISE & [255, 255, 1]
    return zlib.compress(b"".join(b"\0" + row.astype(dtype).tobytes() for row in frame))


def with_size(data: bytes, height: int, width: int, tags: tuple[int, ...] = (256, 257, 278)) -> bytes:
    """Change the size in the header of a picture."""
    patched = bytearray(data)
    if data[:2] == b"\xff\xd8":
        at = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2")) + 5
        patched[at : at + 4] = struct.pack(">HH", height, width)
    elif data[:2] == b"II":
        for tag, value in ((tag, width if tag == 256 else height) for tag in tags):
            at = next(place for kind in (3, 4) if (place := data.find(struct.pack("<HH", tag, kind))) >= 0)
            patched[at + 2 : at + 12] = struct.pack("<HII", 4, 1, value)
    elif data[:2] == b"BM":
        patched[18:26] = struct.pack("<ii", width, height)
    elif data[:2] == b"P6":
        return data.replace(b"128 96", b"%d %d" % (width, height))
    elif data[12:16] == b"VP8 ":
        patched[26:30] = struct.pack("<HH", width, height)
    else:
        bits = struct.unpack("<I", data[21:25])[0] >> 28 << 28
        patched[21:25] = struct.pack("<I", bits | width - 1 | height - 1 << 14)
    return bytes(patched)


@pytest.mark.parametrize("options", JPEGS.values(), ids=JPEGS)
def test_jpeg_cut_short_but_ended_is_refused_and_a_whole_one_with_a_trailer_read(tmp_path: Path, options: dict) -> None:
    path, whole = tmp_path / "a.jpg", encoded("JPEG", **options)
    for trailer in (b"", b"\xff\xd9", b"trailer", whole):
        path.write_bytes(whole + trailer)
        np.testing.assert_array_equal(read_image(path), np.array(Image.open(io.BytesIO(whole)).convert("RGB")))
    begin = whole.find(b"\xff\xda") + 14
    for length in np.linspace(begin, len(whole) - 60, 12, dtype=int):
        rest = b"" if "progressive" in options else whole[length:]  # a progressive JPEG has tables between its scans
        for inserted in (b"", b"\xff\xd9", b"\xff\xd9" + rest, b"\xff\xfe\0\2" + rest):
            path.write_bytes(whole[:length] + inserted)
            refusal(lambda: read_image(path), DataError, path)


@pytest.mark.parametrize("scan", range(1, 6))
def test_progressive_jpeg_without_its_last_scans_is_refused(tmp_path: Path, scan: int) -> None:
    whole = encoded("JPEG", progressive=True)
    tables = whole.split(b"\xff\xda")
    (tmp_path / "a.jpg").write_bytes(b"\xff\xda".join(tables[: scan + 1]) + b"\xff\xd9")
    refusal(lambda: read_image(tmp_path / "a.jpg"), DataError, tmp_path / "a.jpg")


def test_two_pictures_of_one_jpeg_file_give_the_first(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    first, second = Image.fromarray(NOISE), Image.fromarray(NOISE[::-1].copy())
    first.save(buffer, "MPO", save_all=True, append_images=[second])
    (tmp_path / "a.jpg").write_bytes(buffer.getvalue())
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg"), np.array(Image.open(io.BytesIO(encoded("JPEG")))))


HIGHER = {
    "a.png": png(192, 128, rows()),
    "a.ppm": with_size(encoded("PPM"), 192, 128),
    "a.bmp": with_size(encoded("BMP"), 192, 128),
    "lossy.webp": with_size(encoded("WEBP"), 192, 128),
    "lossless.webp": with_size(encoded("WEBP", lossless=True), 192, 128),
    **{f"{name}.jpg": with_size(encoded("JPEG", **options), 192, 128) for name, options in JPEGS.items()},
    **{f"{kind}.tif": with_size(encoded("TIFF", compression=kind), 192, 128) for kind in TIFFS},
    "few strips.tif": with_size(encoded("TIFF"), 192, 128, tags=(257,)),
    "channels.tif": encoded("TIFF").replace(struct.pack("<HHII", 277, 3, 1, 3), struct.pack("<HHII", 277, 3, 1, 235)),
    "jpeg.tif": encoded("TIFF", compression="jpeg"),
    "fax.tif": encoded("TIFF", "1", compression="group4"),
}


@pytest.mark.parametrize("name", HIGHER)
def test_header_that_claims_more_rows_than_the_data_have_is_refused_in_silence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(logging.root, "handlers", [])  # those of pytest
    (tmp_path / name).write_bytes(HIGHER[name])
    refusal(lambda: read_image(tmp_path / name), DataError, tmp_path / name)
    assert capfd.readouterr() == ("", "")


SMALL = NOISE[:8, :8]
HUGE = {
    name: with_size(data, 11000, 12000)
    for name, data in {
        **{f"{name}.jpg": encoded("JPEG", frame=SMALL, **options) for name, options in JPEGS.items()},
        **{f"{kind}.tif": encoded("TIFF", frame=SMALL, compression=kind) for kind in TIFFS},
        "lossy.webp": encoded("WEBP", frame=SMALL),
        "lossless.webp": encoded("WEBP", frame=SMALL, lossless=True),
        "a.bmp": encoded("BMP", frame=SMALL),
    }.items()
} | {"a.png": png(11000, 12000, rows())}


def test_claimed_memory_is_not_taken(tmp_path: Path) -> None:
    def read(name: str) -> None:
        (tmp_path / name).write_bytes(HUGE[name])
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(DataError):
            read_image(tmp_path / name)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50 * 1024

    assert dict(outcomes(read, HUGE)) == dict.fromkeys(HUGE, "returned")


FLOWS = {
    "ok": (png(96, 128, rows(">u2"), bits=16), True),
    "profile": (png(96, 128, rows(">u2"), chunk(b"iCCP", b"x\0\0" + zlib.compress(b"none")), bits=16), True),
    "high": (png(192, 128, rows(">u2"), bits=16), False),
    "low": (png(48, 128, rows(">u2"), bits=16), True),
    "cut": (png(96, 128, rows(">u2")[:-900], bits=16), False),
    "checksum": (png(96, 128, rows(">u2")[:-4] + b"abcd", bits=16), False),
}


@pytest.mark.parametrize("name", FLOWS)
def test_png_flow_is_read_or_refused_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str) -> None:
    data, whole = FLOWS[name]
    path = tmp_path / "flow.png"
    path.write_bytes(data)
    if whole:
        assert read_flow(path)[0].shape[1:] == (128, 2)
    else:
        refusal(lambda: read_flow(path), DataError, path)
    assert capfd.readouterr() == ("", "")


XMP = b'<x xmlns:tiff="http://ns.adobe.com/tiff/1.0/" tiff:Orientation="6"/>'


@pytest.mark.parametrize("place", ["before", "after"])
@pytest.mark.parametrize("tag", ["exif", "xmp"])
def test_orientation_of_a_png_is_applied_wherever_it_stands(tmp_path: Path, place: str, tag: str) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    content = {
        "exif": chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")),
        "xmp": chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP),
    }
    path = tmp_path / "a.png"
    path.write_bytes(png(96, 128, rows(), **{place: content[tag]}))
    np.testing.assert_array_equal(read_image(path), np.rot90(NOISE, -1))
    assert image_size(path) == (128, 96)

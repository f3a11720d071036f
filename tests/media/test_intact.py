"""Damaged files that decoders accept are rejected wherever the format reveals the damage."""

from __future__ import annotations

import io
import random
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from skimage import data

from robustflow.core.errors import DataError
from robustflow.media.flow import read_flow
from robustflow.media.images import read_image
from tests.refusals import refused

PICTURE = data.astronaut()[:96, :128]


def encoded(kind: str, **options) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(PICTURE).save(buffer, kind, **options)
    return buffer.getvalue()


def chunk(name: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + name + content + zlib.crc32(name + content).to_bytes(4, "big")


def png_of(side: int, bits: int, *data: bytes, interlaced: bool = False) -> bytes:
    """Encode a square RGB PNG with correct checksums from arbitrary compressed data."""
    header = side.to_bytes(4, "big") * 2 + bytes([bits, 2, 0, 0, interlaced])
    parts = (chunk(b"IHDR", header), *(chunk(b"IDAT", part) for part in data), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("value", [0, 1])
@pytest.mark.parametrize("interlaced", [False, True])
def test_png_with_too_few_rows_is_refused(tmp_path: Path, interlaced: bool, value: int) -> None:
    path = tmp_path / "a.png"
    sizes = [(1, 1), (1, 1), (2, 1), (2, 2), (4, 2), (4, 4), (8, 4)] if interlaced else [(8, 8)]
    rows = [bytes([0]) + bytes([value]) * 3 * columns for columns, count in sizes for _ in range(count)]
    path.write_bytes(png_of(8, 8, zlib.compress(b"".join(rows)), interlaced=interlaced))
    assert (read_image(path) == value).all()
    path.write_bytes(png_of(8, 8, zlib.compress(b"".join(rows[:-1])), interlaced=interlaced))
    with pytest.raises(DataError, match=r"ends before its last row"):
        read_image(path)


def test_a_png_with_more_data_than_rows_is_not_inflated_to_the_end(tmp_path: Path) -> None:
    stream = zlib.compressobj()
    first = stream.compress(bytes(201)) + stream.flush(zlib.Z_FULL_FLUSH)  # one byte more than the rows
    second = stream.compress(bytes(20_000_000)) + stream.flush()
    (tmp_path / "a.png").write_bytes(png_of(8, 8, first, second))
    tracemalloc.start()
    try:
        assert not read_image(tmp_path / "a.png").any()
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_flow_map_with_too_few_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png_of(8, 16, zlib.compress((bytes([0]) + bytes([1] * 48)) * 6)))
    with pytest.raises(DataError, match=r"ends before its last row|cannot be decoded"):
        read_flow(path)


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"optimize": True}, {"restart_marker_rows": 1}])
def test_jpeg_with_broken_code_is_refused(tmp_path: Path, options: dict) -> None:
    """Pillow reads any file whose markers are intact, but returns wrong pixels."""
    path, whole = tmp_path / "a.jpg", encoded("JPEG", quality=90, **options)
    path.write_bytes(whole)
    assert read_image(path).shape == PICTURE.shape
    scan, refused = whole.index(b"\xff\xda") + 14, 0
    draw = random.Random(0)
    for _ in range(40):
        at = draw.randrange(scan, len(whole) - 40)
        path.write_bytes(whole[:at] + whole[at + draw.randrange(1, 33) :])
        try:
            read_image(path)
        except DataError:
            refused += 1
    assert refused >= 4, "a baseline JPEG resynchronises after most gaps; a progressive one rarely"


def test_jpeg_with_trailing_bytes_is_read(tmp_path: Path) -> None:
    """Cameras append previews and videos to the image."""
    (tmp_path / "a.jpg").write_bytes(encoded("JPEG") + b"\0trailer" * 50)
    assert read_image(tmp_path / "a.jpg").shape == PICTURE.shape


def test_jpegs_that_others_wrote_are_read() -> None:
    """Images from installed packages, created by many different cameras and programs."""
    import matplotlib
    import skimage

    paths = [p for package in (matplotlib, skimage) for p in Path(package.__file__).parent.rglob("*.jp*g")]
    assert len(paths) >= 3
    for path in paths:
        assert read_image(path).size


@pytest.mark.parametrize("kind", ["BMP", "PPM", "WEBP"])
def test_file_longer_than_its_header_states_is_refused(tmp_path: Path, kind: str) -> None:
    path, whole = tmp_path / f"a.{kind.lower()}", encoded(kind)
    middle = len(whole) // 2
    for changed in (whole + b"xyz", whole[:middle] + b"xyz" + whole[middle:]):
        path.write_bytes(changed)
        with pytest.raises(DataError, match=r"too long, or contains several images|damaged"):
            read_image(path)


def test_deflated_tiff_with_a_changed_byte_is_refused(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.tif", encoded("TIFF", compression="tiff_adobe_deflate")
    path.write_bytes(whole)
    expected = read_image(path)
    draw = random.Random(0)
    for _ in range(60):
        at = draw.randrange(8, len(whole))
        path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << draw.randrange(8))]) + whole[at + 1 :])
        try:
            image = read_image(path)
        except DataError:
            continue
        np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize(("name", "options"), [("a.png", {}), ("a.tif", {}), ("a.webp", {"lossless": True})])
def test_file_of_several_images_is_refused(tmp_path: Path, name: str, options: dict) -> None:
    others = [Image.fromarray(PICTURE[::-1].copy()), Image.fromarray(PICTURE[:, ::-1].copy())]
    Image.fromarray(PICTURE).save(tmp_path / name, save_all=True, append_images=others, **options)
    with pytest.raises(DataError, match=r"contains 3 images, .* as separate files"):
        read_image(tmp_path / name)


def test_a_file_that_exceeds_any_image_is_not_read(tmp_path: Path) -> None:
    with open(tmp_path / "a.png", "wb") as file:
        file.truncate(2**43)
    with refused(DataError, r"a\.png: larger than 1024 MiB"):
        read_image(tmp_path / "a.png")


@pytest.mark.slow
def test_a_flow_map_of_many_pixels_costs_no_memory(tmp_path: Path) -> None:
    """20 000 x 20 000 zeros fit into a small PNG but would need 12 GB of memory."""
    path, side = tmp_path / "a.png", 20_000
    compress, parts = zlib.compressobj(9), []
    for _ in range(side):
        parts.append(compress.compress(bytes(1 + 6 * side)))
    rows = b"".join([*parts, compress.flush()])
    path.write_bytes(png_of(side, 16, rows))
    assert path.stat().st_size < 5_000_000
    with pytest.raises(DataError, match="20000x20000 pixels exceed"):
        read_flow(path)


def test_the_largest_flow_of_a_data_set_is_below_the_cap(tmp_path: Path) -> None:
    picture = np.ones((2160, 3840, 3), np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    flow, valid = read_flow(tmp_path / "a.png")
    assert flow.shape == (2160, 3840, 2)
    assert valid.all()

"""Images are read back unchanged, or rejected with a reason."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from robustflow.core.errors import DataError
from robustflow.media.images import image_size, read_image, read_mask, stored_size, write_image
from tests import refusals

RGB = (np.arange(12 * 17 * 3).reshape(12, 17, 3) * 37 % 251).astype(np.uint8)


def refused(path: Path, match: str) -> None:
    with refusals.refused(DataError, match) as caught:
        read_image(path)
    assert str(path) in str(caught.value)


@given(image=hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3))))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_written_images_read_back_equal_also_by_opencv(tmp_path: Path, image: np.ndarray) -> None:
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], image)
    assert image_size(tmp_path / "a.png") == image.shape[:2]
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("suffix", ["png", "ppm", "bmp", "tiff"])
def test_lossless_formats_written_by_opencv_are_read_exactly(tmp_path: Path, suffix: str) -> None:
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), RGB[..., ::-1])
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}"), RGB)


@pytest.mark.parametrize("suffix", ["png", "pgm", "bmp", "tiff", "jpg"])
def test_grey_becomes_three_equal_channels(tmp_path: Path, suffix: str) -> None:
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), RGB[..., 0])
    grey = cv2.imread(str(tmp_path / f"a.{suffix}"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}"), np.repeat(grey[..., None], 3, axis=2))


@pytest.mark.parametrize("suffix", ["png", "jpg", "ppm", "tiff", "webp"])
@pytest.mark.parametrize("size", [12, 90])
def test_truncated_images_are_refused(tmp_path: Path, suffix: str, size: int) -> None:
    """The content is smooth, because decoders replace missing parts of such images with plausible values."""
    y, x = np.mgrid[:size, :size]
    image = np.stack([x * 2, y * 2, x + y], axis=-1).astype(np.uint8)
    whole = cv2.imencode(f".{suffix}", image)[1].tobytes()
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(whole)
    assert read_image(path).shape == (size, size, 3)
    for length in [*range(0, len(whole), max(1, len(whole) // 150)), len(whole) - 1]:
        path.write_bytes(whole[:length])
        refused(path, "truncated|damaged|empty")


def test_a_flipped_byte_of_a_png_is_detected_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_image(path, RGB)
    whole = path.read_bytes()
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        try:
            image = read_image(path)
        except DataError:
            continue
        np.testing.assert_array_equal(image, RGB)


@pytest.mark.parametrize("suffix", ["png", "tiff", "ppm"])
@pytest.mark.parametrize("channels", [1, 3])
def test_sixteen_bits_are_refused(tmp_path: Path, suffix: str, channels: int) -> None:
    name = f"a.{'pgm' if (suffix, channels) == ('ppm', 1) else suffix}"
    cv2.imwrite(str(tmp_path / name), np.full((4, 5, channels), 300, np.uint16))
    refused(tmp_path / name, "more than 8 bits per channel")


def test_alpha_is_dropped_only_if_opaque(tmp_path: Path) -> None:
    image = np.dstack([RGB, np.full(RGB.shape[:2], 255, np.uint8)])
    Image.fromarray(image).save(tmp_path / "opaque.png")
    np.testing.assert_array_equal(read_image(tmp_path / "opaque.png"), RGB)
    image[3, 4, 3] = 254
    Image.fromarray(image).save(tmp_path / "alpha.png")
    refused(tmp_path / "alpha.png", "transparent")
    colour = tuple(RGB[0, 0].tolist())
    Image.fromarray(RGB).save(tmp_path / "key.png", transparency=colour)
    refused(tmp_path / "key.png", "transparent")


def test_other_colour_spaces_are_refused(tmp_path: Path) -> None:
    Image.fromarray(RGB).convert("CMYK").save(tmp_path / "a.jpg")
    refused(tmp_path / "a.jpg", "CMYK")


def test_palette_and_one_bit_images_are_read_as_rgb(tmp_path: Path) -> None:
    palette = Image.fromarray(RGB).quantize(8)
    palette.save(tmp_path / "p.png")
    np.testing.assert_array_equal(read_image(tmp_path / "p.png"), np.array(palette.convert("RGB")))
    Image.fromarray(RGB[..., 0] > 99).save(tmp_path / "b.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "b.png"), RGB[..., 0] > 99)


@pytest.mark.parametrize("suffix", ["png", "tiff"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_as_opencv_does(tmp_path: Path, orientation: int, suffix: str) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{suffix}"
    for name in (path, tmp_path / "by_opencv.png"):  # OpenCV fails to read a TIFF turned by 90 degrees
        Image.fromarray(RGB).save(name, exif=exif)
    image = read_image(path)
    np.testing.assert_array_equal(image, cv2.imread(str(tmp_path / "by_opencv.png"))[..., ::-1])
    assert image_size(path) == image.shape[:2]
    assert stored_size(path) == RGB.shape[:2]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "empty"),
        (b"<!DOCTYPE html>", "not an image"),
        (b"GIF89a" + bytes(40), "not an image"),
        (b"P6\n99999 99999\n255\n" + bytes(36), "damaged|more than"),
        (b"P6\n12000 12000\n255\n" + bytes(36), "damaged|pixels exceed"),
    ],
)
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_file_that_is_not_an_image_is_refused(tmp_path: Path, content: bytes, match: str) -> None:
    (tmp_path / "a.ppm").write_bytes(content)
    refused(tmp_path / "a.ppm", match)
    refused(tmp_path / "missing.png", "no such image")


@pytest.mark.parametrize(
    ("name", "image"),
    [("a.jpg", RGB), ("a.png", RGB[..., 0]), ("a.png", RGB.astype(float)), ("a.png", RGB[:0]), ("no/a.png", RGB)],
)
def test_refused_writing_leaves_no_file(tmp_path: Path, name: str, image: np.ndarray) -> None:
    with pytest.raises(DataError):
        write_image(tmp_path / name, image)
    assert list(tmp_path.iterdir()) == []


def test_size_of_an_image_is_read_without_its_pixels(tmp_path: Path) -> None:
    Image.fromarray(RGB).save(tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: whole.index(b"IDAT") + 6])
    assert stored_size(tmp_path / "cut.png") == image_size(tmp_path / "cut.png") == RGB.shape[:2]
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(RGB).save(tmp_path / "turned.jpg", exif=exif)
    assert stored_size(tmp_path / "turned.jpg") == RGB.shape[:2]
    assert image_size(tmp_path / "turned.jpg") == RGB.shape[1::-1]
    Image.fromarray(RGB).save(tmp_path / "turned.png", exif=exif)
    whole = (tmp_path / "turned.png").read_bytes()
    start, end = whole.index(b"eXIf") - 4, whole.index(b"IDAT") - 4
    (tmp_path / "behind.png").write_bytes(whole[:start] + whole[end:-12] + whole[start:end] + whole[-12:])
    assert image_size(tmp_path / "behind.png") == read_image(tmp_path / "behind.png").shape[:2] == RGB.shape[1::-1]
    (tmp_path / "text.png").write_text("text")
    with pytest.raises(DataError, match="cannot be read as an image"):
        stored_size(tmp_path / "text.png")

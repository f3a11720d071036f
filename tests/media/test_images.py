"""Images are read back unchanged, or refused by their path."""

from __future__ import annotations

import io
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
from tests.refusals import refusal

RGB = (np.arange(12 * 17 * 3).reshape(12, 17, 3) * 37 % 251).astype(np.uint8)


def refused(path: Path) -> None:
    refusal(lambda: read_image(path), DataError, path)


def encoded(kind: str, image: np.ndarray = RGB, **options) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, kind, **options)
    return buffer.getvalue()


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
    end = len(whole) - 4 * (suffix == "png")  # the checksum of a PNG's empty last chunk
    for length in [*range(0, end, max(1, end // 150)), end - 1]:
        path.write_bytes(whole[:length])
        refused(path)


@pytest.mark.parametrize("suffix", ["png", "tiff", "ppm"])
@pytest.mark.parametrize("channels", [1, 3])
def test_sixteen_bits_are_refused(tmp_path: Path, suffix: str, channels: int) -> None:
    path = tmp_path / f"a.{'pgm' if (suffix, channels) == ('ppm', 1) else suffix}"
    cv2.imwrite(str(path), np.full((4, 5, channels), 300, np.uint16))
    refused(path)


def test_alpha_is_dropped_only_if_opaque(tmp_path: Path) -> None:
    image = np.dstack([RGB, np.full(RGB.shape[:2], 255, np.uint8)])
    Image.fromarray(image).save(tmp_path / "opaque.png")
    np.testing.assert_array_equal(read_image(tmp_path / "opaque.png"), RGB)
    image[3, 4, 3] = 254
    Image.fromarray(image).save(tmp_path / "alpha.png")
    Image.fromarray(RGB).save(tmp_path / "key.png", transparency=tuple(RGB[0, 0].tolist()))
    for name in ("alpha.png", "key.png"):
        refused(tmp_path / name)


def test_palette_and_one_bit_images_are_read_as_rgb(tmp_path: Path) -> None:
    palette = Image.fromarray(RGB).quantize(8)
    palette.save(tmp_path / "p.png")
    np.testing.assert_array_equal(read_image(tmp_path / "p.png"), np.array(palette.convert("RGB")))
    Image.fromarray(RGB[..., 0] > 99).save(tmp_path / "b.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "b.png"), RGB[..., 0] > 99)


@pytest.mark.parametrize("suffix", ["png", "tiff", "jpg"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_as_opencv_does(tmp_path: Path, orientation: int, suffix: str) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{suffix}"
    by_opencv = tmp_path / f"by_opencv.{suffix.replace('tiff', 'png')}"  # OpenCV reads no turned TIFF
    for name in (path, by_opencv):
        Image.fromarray(RGB).save(name, exif=exif)
    image = read_image(path)
    np.testing.assert_array_equal(image, cv2.imread(str(by_opencv))[..., ::-1])
    assert image_size(path) == image.shape[:2]
    assert stored_size(path) == RGB.shape[:2]


def several(kind: str, **options) -> bytes:
    others = [Image.fromarray(RGB[::-1].copy())]
    return encoded(kind, save_all=True, append_images=others, **options)


CMYK = io.BytesIO()
Image.fromarray(RGB).convert("CMYK").save(CMYK, "JPEG")
NO_IMAGES = {
    "empty.png": b"",
    "text.ppm": b"<!DOCTYPE html>",
    "animated.gif": b"GIF89a" + bytes(40),
    "huge.ppm": b"P6\n99999 99999\n255\n" + bytes(36),
    "large.ppm": b"P6\n12000 12000\n255\n" + bytes(36),
    "cmyk.jpg": CMYK.getvalue(),
    "several.png": several("PNG"),
    "several.tif": several("TIFF"),
    "several.webp": several("WEBP", lossless=True),
}


@pytest.mark.parametrize("name", NO_IMAGES)
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_file_that_is_not_one_supported_image_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(NO_IMAGES[name])
    refused(tmp_path / name)


def test_missing_and_endless_images_are_refused(tmp_path: Path) -> None:
    with open(tmp_path / "endless.png", "wb") as file:
        file.truncate(2**43)
    for name in ("missing.png", ".", "endless.png"):
        refused(tmp_path / name)


def test_jpegs_that_others_wrote_are_read(tmp_path: Path) -> None:
    """Images from installed packages, created by many different cameras and programs; and one with a trailer."""
    import matplotlib
    import skimage

    (tmp_path / "a.jpg").write_bytes(encoded("JPEG") + b"\0trailer" * 50)
    paths = [p for package in (matplotlib, skimage) for p in Path(package.__file__).parent.rglob("*.jp*g")]
    assert len(paths) >= 3
    for path in (tmp_path / "a.jpg", *paths):
        assert read_image(path).size


@pytest.mark.parametrize(
    ("name", "image"),
    [("a.jpg", RGB), ("a.png", RGB[..., 0]), ("a.png", RGB.astype(float)), ("a.png", RGB[:0]), ("no/a.png", RGB)],
)
def test_refused_writing_leaves_no_file(tmp_path: Path, name: str, image: np.ndarray) -> None:
    with pytest.raises(DataError):
        write_image(tmp_path / name, image)
    assert list(tmp_path.iterdir()) == []


def test_size_of_an_image_is_read_without_its_pixels(tmp_path: Path) -> None:
    whole = encoded("PNG")
    (tmp_path / "cut.png").write_bytes(whole[: whole.index(b"IDAT") + 6])
    assert stored_size(tmp_path / "cut.png") == image_size(tmp_path / "cut.png") == RGB.shape[:2]
    (tmp_path / "text.png").write_text("text")
    refusal(lambda: stored_size(tmp_path / "text.png"), DataError, tmp_path / "text.png")

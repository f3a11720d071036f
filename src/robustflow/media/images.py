"""Read and write images as RGB uint8, without lossy conversions; list the images in a folder.

Images are decoded with Pillow, and must contain all pixels (`complete`). A PNG's checksums are verified. Other damage
only changes pixel values, so a run's manifest stores a hash of every file.
"""

from __future__ import annotations

import base64
import io
import logging
import re
import struct
import warnings
import zlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps, TiffImagePlugin

from ..core import files
from ..core.errors import DataError, first_line
from ..core.paths import refuse_backslashes
from ..core.text import is_utf8
from ..core.types import Frame
from .arrays import readable
from .complete import PNG, png_header, silent_libraries, without_end

logging.getLogger("PIL").addHandler(logging.NullHandler())  # otherwise, Python prints its errors

LARGEST = 2**30
"""Maximum size of an image file in bytes; the largest supported image needs half as much."""

MAX_PIXELS = 2**27
"""Largest supported image, 134 megapixels; larger images are rejected before their pixels are allocated."""

PILLOW_ERRORS = (
    OSError, ValueError, SyntaxError, TypeError, LookupError, EOFError, OverflowError, struct.error, zlib.error,
    Image.DecompressionBombError,
)  # fmt: skip
"""Exceptions that Pillow raises for damaged files."""

_WIDTH, _HEIGHT = 256, 257
"""TIFF tags that store the size of the image."""

_PLANES = 284
"""TIFF tag that is 2 if each channel is stored in separate strips."""

_TIFF_RATIO = {"raw": 8, "packbits": 64, "tiff_lzw": 4096, "tiff_adobe_deflate": 1032, "tiff_deflate": 1032}
"""Highest ratio of the compressions of TIFF whose decoders need all data."""

_WEBP_RATIO = 2048
"""Highest number of pixels per byte of large WebP images. Only lossless images of one colour have more."""

_SMALL = 2**24

_ORIENTATION = 0x0112

_FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "WEBP")


def read_image(path: str | Path) -> Frame:
    """Read an image as RGB uint8 (H, W, 3): PNG, JPEG, PPM/PGM, BMP, TIFF or WebP."""
    path = Path(path)
    with readable(path):
        if path.stat().st_size > LARGEST:
            raise DataError(path, f"larger than {LARGEST >> 20} MiB, so it is not a supported image; check the file")
        data = path.read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # no warnings: damaged files always raise an error instead
            data, other = without_end(data)
            with _open(path, data) as image:
                wanted = hash(Image.open(io.BytesIO(other)).tobytes()) if other else None
                with silent_libraries() if image.format == "TIFF" else nullcontext():
                    image.load()
                if wanted is not None and hash(image.tobytes()) != wanted:
                    raise DataError(path, "truncated: one of its scans is too short; copy or download it again")
                ImageOps.exif_transpose(image, in_place=True)
                return _rgb(path, image)
    except PILLOW_ERRORS as error:
        raise DataError(path, f"damaged or truncated ({first_line(error)}); copy or download it again") from error


def image_size(path: str | Path) -> tuple[int, int]:
    """Return the size (H, W) of the image that `read_image` would return; no pixels are decoded."""
    (height, width), turned = _header(path, lambda image: Image.Image.getexif(image).get(_ORIENTATION, 1) >= 5)
    return (width, height) if turned else (height, width)


def stored_size(path: str | Path) -> tuple[int, int]:
    """Return the size (H, W) stored in the header, before the EXIF orientation is applied; no pixels are decoded."""
    return _header(path, lambda image: False)[0]


def read_mask(path: str | Path) -> npt.NDArray[np.bool_]:
    """Read an image as a mask, bool (H, W), True where any channel is nonzero."""
    return np.asarray(read_image(path).any(axis=2))


def write_image(path: str | Path, image: Frame) -> None:
    """Write an RGB uint8 (H, W, 3) image to a PNG file atomically. The file name must end in .png."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise DataError(path, "images are written as lossless PNG; use a file name that ends in .png")
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise DataError(path, f"cannot write {image.dtype} {image.shape} as an image; pass RGB uint8 (H, W, 3)")
    files.write_bytes(path, png_bytes(image))


def shrunk(image: Frame, widest: int) -> Frame:
    """Reduce an RGB uint8 (H, W, 3) image to a width of `widest` pixels by averaging; narrower images are returned
    unchanged.
    """
    height, width = image.shape[:2]
    if width <= widest:
        return image
    size = (widest, max(1, round(height * widest / width)))
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize(size, Image.Resampling.BOX))


def png_bytes(image: Frame) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def jpeg_bytes(image: Frame, quality: int = 80) -> bytes:
    """Encode an RGB uint8 (H, W, 3) image as JPEG, for display only: noise and fine colour detail are lost."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def jpeg_address(image: Frame, widest: int, quality: int = 80) -> str:
    """Encode an RGB uint8 (H, W, 3) image as a JPEG `data:` URL, at most `widest` pixels wide; see `jpeg_bytes`."""
    data = jpeg_bytes(shrunk(image, widest), quality)
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


def png_address(image: Frame) -> str:
    """Encode an RGB uint8 (H, W, 3) image as a lossless `data:` URL."""
    return "data:image/png;base64," + base64.b64encode(png_bytes(image)).decode()


def _header(path: str | Path, is_turned: Callable[[Image.Image], bool]) -> tuple[tuple[int, int], bool]:
    path = Path(path)
    with readable(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the caller decides which sizes are too large
        try:
            with open(path, "rb") as file:
                is_png = file.read(len(PNG)) == PNG
                header = io.BytesIO(png_header(file)) if is_png else path
            with Image.open(header, formats=_FORMATS) as image:
                width, height = image.size
                if isinstance(image, TiffImagePlugin.TiffImageFile):  # `image.size` is the size after the rotation
                    width, height = image.tag_v2[_WIDTH], image.tag_v2[_HEIGHT]
                return (height, width), is_turned(image)
        except PILLOW_ERRORS as error:
            raise DataError(path, f"cannot be read as an image ({first_line(error)}); check the file") from error


def _open(path: Path, data: bytes) -> Image.Image:
    """Open an image whose size and depth are supported, and which is the only one in its file."""
    try:
        image = Image.open(io.BytesIO(data), formats=_FORMATS)
    except Image.UnidentifiedImageError as error:
        kinds = "PNG, JPEG, PPM, BMP, TIFF or WebP"
        raise DataError(path, f"not an image ({kinds}), or its header is damaged; check the file") from error
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise DataError(path, f"{height}x{width} pixels exceed the limit of {MAX_PIXELS}; scale the image down")
    if _is_deep(image):
        raise DataError(path, "more than 8 bits per channel; convert it to 8 bits (flow maps are not images)")
    count = getattr(image, "n_frames", 1)
    if count > 1 and image.format != "MPO":  # the first image of an MPO file is the main one
        raise DataError(path, f"contains {count} images, but only one can be read; save them as separate files")
    if isinstance(image, TiffImagePlugin.TiffImageFile):
        _check_tiff(path, image, len(data))
    if image.format == "WEBP" and width * height > max(_SMALL, _WEBP_RATIO * len(data)):
        raise DataError(path, f"claims {height}x{width} pixels, too many for {len(data)} bytes; save it as PNG")
    return image


def _check_tiff(path: Path, image: TiffImagePlugin.TiffImageFile, size: int) -> None:
    """Raise unless the parts of the image cover it, and its compression is one whose decoder needs all data."""
    compression = image.info.get("compression")
    if compression not in _TIFF_RATIO:
        raise DataError(
            path, f"{compression} inside TIFF is not supported, because losses go unnoticed; save it as PNG"
        )
    pixels = image.tag_v2[_WIDTH] * image.tag_v2[_HEIGHT]
    planes = len(image.getbands()) if image.tag_v2.get(_PLANES) == 2 else 1
    parts = [part.extents or (0, 0, 0, 0) for part in image.tile]
    covered = sum((right - left) * (bottom - top) for left, top, right, bottom in parts)
    if covered < pixels * planes or pixels // 8 > _TIFF_RATIO[compression] * size:
        raise DataError(path, "truncated: its data do not cover the image; copy or download it again")


def _is_deep(image: Image.Image) -> bool:
    """Whether Pillow would reduce the file's channels to 8 bits, or return channels wider than 8 bits."""
    if image.mode in ("I", "F") or image.mode.startswith("I;"):
        return True
    tiles = getattr(image, "tile", [])
    layout = [str(part) for tile in tiles for part in (tile[3] if isinstance(tile[3], tuple) else tile[3:])]
    if image.format == "PPM":
        return any(part.isdigit() and int(part) > 255 for part in layout)
    return any(";16" in part or ";32" in part for part in layout)


def _rgb(path: Path, image: Image.Image) -> Frame:
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        image = image.convert("RGBA")
        if image.getchannel("A").getextrema() != (255, 255):
            raise DataError(path, "the image has transparent pixels; flatten it onto a background first")
    if image.mode not in ("1", "L", "P", "RGB", "RGBA"):
        raise DataError(path, f"colour mode {image.mode} is not supported; convert the image to 8-bit RGB")
    return np.array(image if image.mode == "RGB" else image.convert("RGB"))  # a conversion always copies


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
"""Extensions of the files that are treated as images when a folder is listed."""


def images_in(folder: Path) -> list[Path]:
    """Return the images directly inside a folder in natural order, or by time if their names are times in seconds,
    without hidden files."""
    refuse_backslashes(folder)
    entries = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != ".")
    images = [path for path in entries if path.is_file()]
    by_time = are_decimals([path.stem for path in images])
    ordered = sorted(images, key=lambda path: _decimal(path.stem) if by_time else natural_order(path.name))
    for path in ordered:
        if not is_utf8(str(path)):
            raise DataError(path, "the name is not valid UTF-8; rename the file or folder")
    return ordered


def natural_order(name: str) -> tuple[tuple[tuple[int, int | str], ...], str]:
    """Return a sort key that compares digits inside names as numbers.

    >>> sorted(["frame10.png", "frame9.png", "Frame1.png"], key=natural_order)
    ['Frame1.png', 'frame9.png', 'frame10.png']
    """
    parts = re.findall(r"[0-9]+|[^0-9]+", name.casefold())
    return tuple((0, int(part)) if part[0] in "0123456789" else (1, part) for part in parts), name


def are_decimals(stems: Sequence[str]) -> bool:
    """Return whether names without suffix end in decimals, such as times in seconds, and not in two whole numbers: read
    as decimals, their steps are at least as regular.

    >>> are_decimals(["t98.175304", "t98.2", "t98.2249", "t98.25"]), are_decimals([f"shot1.{n}" for n in range(8, 13)])
    (True, False)
    """
    names = [_DECIMAL.fullmatch(stem) for stem in stems]
    parts = [(name[1], int(name[2]), name[3] or "") for name in names if name]
    if (
        len(parts) < max(2, len(stems))
        or len({text for text, *_ in parts}) > 1
        or not any(fraction for *_, fraction in parts)
    ):
        return False
    decimals = sorted(whole + float(f"0.{fraction or 0}") for _, whole, fraction in parts)
    numbers = sorted((whole, int(fraction or 0)) for _, whole, fraction in parts)
    as_decimals = [later - earlier for earlier, later in pairwise(decimals)]
    as_numbers = [n - m if i == j else -1 for (i, m), (j, n) in pairwise(numbers)]
    return _regular(as_decimals) >= _regular(as_numbers)


_DECIMAL = re.compile(r"(|.*?[^0-9])([0-9]+)(?:\.([0-9]+))?", re.DOTALL)


def _decimal(stem: str) -> tuple[int, str, str]:
    parts = _DECIMAL.fullmatch(stem)
    assert parts is not None
    return int(parts[2]), parts[3] or "", stem


def _regular(steps: Sequence[float]) -> int:
    """Return how many steps are about equal."""
    ordered = sorted(step for step in steps if step > 0)
    return max((bisect_right(ordered, 1.2 * step) - bisect_left(ordered, step) for step in ordered), default=0)

"""Detect damage in image files that decoders ignore, as far as the file format allows. Read and write images as RGB
uint8, without lossy conversions. List the images in a folder.

PNG and deflated TIFF files contain checksums, damage to a JPEG usually breaks its entropy coding, and BMP, PPM and WebP
headers imply or state the file size. Other damage only changes pixel values and cannot be detected, so a run's manifest
stores a hash of every file.

Images are decoded with Pillow, which is strict: for truncated files it raises an error instead of returning a partly
filled image. `intact` detects damage that Pillow overlooks.
"""

from __future__ import annotations

import base64
import io
import re
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps, PngImagePlugin, TiffImagePlugin

from ..core import files as atomic
from ..core.errors import DataError, first_line
from ..core.text import is_utf8
from ..core.types import Frame

_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
MOST_INFLATED = 1100
"""Deflate cannot compress data by more than 1032:1, so a file that claims a higher ratio is damaged."""

LARGEST = 2**30
"""Maximum size of an image file in bytes; the largest supported image needs half as much."""


class PngHeader(NamedTuple):
    """A PNG header: image size, bits per channel, and number of channels (a palette counts as one)."""

    width: int
    height: int
    bits: int
    channels: int


def check_png(path: Path, data: bytes) -> PngHeader:
    """Read a PNG header and check, without decoding, that all chunks are present and undamaged."""
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR" or len(data) < 33:
        raise DataError(path, "not a PNG file, or truncated; check or copy it again")
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    header = PngHeader(width, height, bits, _PNG_CHANNELS.get(kind, 0))
    if width * height * bits * header.channels > 8 * MOST_INFLATED * len(data):
        raise DataError(
            path, f"damaged: {len(data)} bytes are too few for {height}x{width} pixels; copy or download it again"
        )
    view, start, name = memoryview(data), 8, b""
    while name != b"IEND":
        length = int.from_bytes(view[start : start + 4], "big")
        end = start + 12 + length
        if end > len(data):
            raise DataError(path, "truncated, the end of the PNG is missing; copy or download it again")
        name = data[start + 4 : start + 8]
        # Pillow stops reading after the last row, before it reaches the checksum of the last chunk.
        if zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise DataError(path, "damaged, a checksum of the PNG is wrong; copy or download it again")
        start = end
    return header


def check_png_rows(path: Path, data: bytes, pixels: np.ndarray[Any, Any], interlaced: bool) -> None:
    """Reject a PNG whose compressed data ends before the last row; Pillow would fill the missing rows with zeros, while
    libpng, which OpenCV uses, does not decode it.
    """
    import cv2

    suspect = interlaced or not pixels[-1:].any()
    if suspect and cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is None:
        raise DataError(path, "damaged, the PNG ends before its last row; copy or download it again")


def check_jpeg(path: Path, data: bytes) -> None:
    """Reject a JPEG with broken entropy coding; Pillow's decoder would silently continue with grey or shifted
    blocks.
    """
    import av

    context = av.CodecContext.create("mjpeg", "r")
    context.thread_count = 1
    context.options = {"err_detect": "crccheck+bitstream+buffer+careful+compliant+aggressive+explode"}
    try:
        frames: list[Any] = [*context.decode(av.Packet(data)), *context.decode(None)]
    except av.error.PatchWelcomeError:
        return
    except (av.error.FFmpegError, ValueError) as error:
        raise DataError(path, "damaged, the JPEG data is corrupt; copy it again") from error
    if not frames or any(frame.is_corrupt for frame in frames):
        raise DataError(path, "damaged, the JPEG data is corrupt; copy it again")


def check_length(path: Path, data: bytes, kind: str | None, end: int = 0) -> None:
    """Reject a file that is longer or shorter than its header implies."""
    sizes: tuple[int, ...] = ()
    if kind == "WEBP":
        size = int.from_bytes(data[4:8], "little")
        sizes = (8 + size, 8 + size + size % 2)
    elif kind == "BMP":
        sizes = (int.from_bytes(data[2:6], "little") or len(data),)
    elif kind == "PPM" and end and data[end:].strip():
        sizes = (end,)
    if sizes and len(data) not in sizes:
        state = "truncated" if len(data) < sizes[0] else "too long, or contains several images"
        raise DataError(
            path, f"{state}: {len(data)} bytes, but the header implies {sizes[0]}; copy or convert it again"
        )


def check_deflated_strips(path: Path, data: bytes, offsets: Any, counts: Any) -> None:
    """Reject a deflated TIFF with a wrong strip checksum, which libtiff does not verify."""
    for offset, count in zip(offsets or (), counts or (), strict=False):
        inflate, part = zlib.decompressobj(), memoryview(data)[offset : offset + count].tobytes()
        try:
            while not inflate.eof:
                out = inflate.decompress(part, 2**20)
                part = inflate.unconsumed_tail
                if not out and not part:
                    raise DataError(path, "damaged, a strip of the TIFF is truncated; copy it again")
        except zlib.error as error:
            raise DataError(path, "damaged, a checksum of the TIFF is wrong; copy it again") from error


MAX_PIXELS = 2**27
"""Largest supported image, 134 megapixels; larger images are rejected before their pixels are allocated."""

_OF_PILLOW = (
    OSError, ValueError, SyntaxError, TypeError, LookupError, EOFError, OverflowError, struct.error, zlib.error,
    Image.DecompressionBombError,
)  # fmt: skip
"""Exceptions that Pillow raises for damaged files."""

_STRIPS = (273, 279, 324, 325)
"""TIFF tags that store the offsets and byte counts of strips or tiles."""

_WIDTH, _HEIGHT = 256, 257
"""TIFF tags that store the size of the image."""

_FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "WEBP")


def read_image(path: str | Path) -> Frame:
    """Read an image as RGB uint8 (H, W, 3): PNG, JPEG, PPM/PGM, BMP, TIFF or WebP."""
    path = Path(path)
    data = _contents(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # no warnings: damaged files always raise an error instead
            with _open(path, data) as image:
                _check_intact(path, data, image)
                image.load()
                if image.format == "PNG":
                    check_png_rows(path, data, np.asarray(image), "interlace" in image.info)
                return _rgb(path, ImageOps.exif_transpose(image))
    except DataError:
        raise
    except _OF_PILLOW as error:
        raise DataError(path, f"damaged or truncated ({first_line(error)}); copy or download it again") from error


def image_size(path: str | Path) -> tuple[int, int]:
    """Return the size (H, W) of the image that `read_image` would return; pixels are decoded only for a PNG with
    metadata behind them.
    """
    (height, width), turned = _header(path, _is_turned)
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
    atomic.write_bytes(path, png_bytes(image))


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
    """Encode an RGB uint8 (H, W, 3) image as PNG."""
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
    """Return the stored size (H, W), and whether the image is turned by 90 degrees according to `is_turned`."""
    path = Path(path)
    _check_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller decides which sizes are too large
            with Image.open(path, formats=_FORMATS) as image:
                width, height = image.size
                if isinstance(image, TiffImagePlugin.TiffImageFile):  # `image.size` is the size after the rotation
                    width, height = image.tag_v2[_WIDTH], image.tag_v2[_HEIGHT]
                return (height, width), is_turned(image)
    except _OF_PILLOW as error:
        raise DataError(path, f"cannot be read as an image ({first_line(error)}); check the file") from error


def _is_turned(image: Image.Image) -> bool:
    """Whether the EXIF orientation swaps width and height. Pillow decodes a PNG to find metadata behind the pixels."""
    ends_early = isinstance(image, PngImagePlugin.PngImageFile) and not _has_metadata_behind_pixels(image.fp)
    exif = Image.Image.getexif(image) if ends_early else image.getexif()
    return exif.get(0x0112, 1) in (5, 6, 7, 8)


def _has_metadata_behind_pixels(png: Any) -> bool:
    pixels, start, place = False, png.tell(), 8
    while len(head := png.read(8) if png.seek(place) else b"") == 8:
        pixels |= head[4:] == b"IDAT"
        if pixels and head[4:] in (b"eXIf", b"tEXt", b"zTXt", b"iTXt"):
            break
        place += 12 + int.from_bytes(head[:4], "big")
    png.seek(start)
    return len(head) == 8


def _check_file(path: Path) -> None:
    """Raise a DataError unless the path is a regular file; opening a pipe would block forever."""
    if not path.is_file():
        why = "not a file (a pipe, a device or a folder)" if path.exists() else "no such image file; check the path"
        raise DataError(path, f"{why}")


def _contents(path: Path) -> bytes:
    _check_file(path)
    try:
        if path.stat().st_size > LARGEST:
            raise DataError(path, f"larger than {LARGEST >> 20} MiB, so it is not a supported image; check the file")
        data = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error}); check its permissions") from error
    if not data:
        raise DataError(path, "the file is empty; copy or download it again")
    return data


def _open(path: Path, data: bytes) -> Image.Image:
    deep = data[:4] == b"\x89PNG" and check_png(path, data).bits > 8
    try:
        image = Image.open(io.BytesIO(data), formats=_FORMATS)
    except Image.UnidentifiedImageError as error:
        kinds = "PNG, JPEG, PPM, BMP, TIFF or WebP"
        raise DataError(path, f"not an image ({kinds}), or its header is damaged; check the file") from error
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise DataError(path, f"{height}x{width} pixels exceed the limit of {MAX_PIXELS}; scale the image down")
    if deep or _is_deep(image):
        raise DataError(path, "more than 8 bits per channel; convert it to 8 bits (flow maps are not images)")
    return image


def _check_intact(path: Path, data: bytes, image: Image.Image) -> None:
    """Reject files with several images, and damage that the decoder would ignore."""
    frames = getattr(image, "n_frames", 1)
    if frames > 1 and image.format != "MPO":  # the first image of an MPO file is the main one
        raise DataError(
            path,
            f"contains {frames} images, but only one can be read; save them as separate files and pass their folder",
        )
    end = 0
    tiles = getattr(image, "tile", [])
    if image.format == "PPM" and tiles and tiles[0][0] == "raw" and image.mode in ("L", "RGB"):
        end = tiles[0][2] + image.width * image.height * len(image.mode)
    check_length(path, data, image.format, end)
    if image.format in ("JPEG", "MPO"):
        check_jpeg(path, data)
    if isinstance(image, TiffImagePlugin.TiffImageFile) and image.tag_v2.get(259) in (8, 32946):
        check_deflated_strips(path, data, *(image.tag_v2.get(tag) for tag in _STRIPS if tag in image.tag_v2))


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
    return np.array(image.convert("RGB"))


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
"""Extensions of the files that are treated as images when a folder is listed."""


def images_in(folder: Path) -> list[Path]:
    """Return the images directly inside a folder in natural order, without hidden files."""
    images = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != ".")
    ordered = sorted((path for path in images if path.is_file()), key=lambda path: natural_order(path.name))
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

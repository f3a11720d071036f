"""List the images in a folder."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import DataError
from ..text import is_utf8

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
"""Extensions of the files that are treated as images when a folder is listed."""


def images_in(folder: Path) -> list[Path]:
    """Return the images directly inside a folder in natural order, without hidden files."""
    images = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != ".")
    ordered = sorted((path for path in images if path.is_file()), key=lambda path: natural_order(path.name))
    for path in ordered:
        if not is_utf8(str(path)):
            raise DataError(f"{path}: the name is not valid UTF-8; rename the file or folder")
    return ordered


def natural_order(name: str) -> tuple[tuple[tuple[int, int | str], ...], str]:
    """Return a sort key that compares digits inside names as numbers.

    >>> sorted(["frame10.png", "frame9.png", "Frame1.png"], key=natural_order)
    ['Frame1.png', 'frame9.png', 'frame10.png']
    """
    parts = re.findall(r"[0-9]+|[^0-9]+", name.casefold())
    return tuple((0, int(part)) if part[0] in "0123456789" else (1, part) for part in parts), name

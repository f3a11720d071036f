"""The clips that `robustflow prepare` reads: a video file, or a folder of images."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

from ...core.errors import DataError
from ...core.types import Frame
from ...media.images import image_size, images_in, read_image
from .reader import VideoReader

_LONGEST_NAME = 160
"""Maximum length of a clip's name, in bytes; the cache appends up to 60, and a file name may have 255."""


class Source(Protocol):
    """The frames of a clip, in order; they can be read repeatedly."""

    name: str
    count: int
    size: tuple[int, int]
    fps: Fraction | None
    """Frames per second; None if the source does not declare a rate (images)."""

    def frames(self) -> Iterator[Frame]:
        """Yield all frames, RGB uint8 (H, W, 3)."""

    def describe(self) -> dict[str, Any]:
        """Return a description of the source for the manifest."""


class PictureFolder:
    """A clip that consists of all images in a folder, in natural order."""

    fps: Fraction | None = None

    def __init__(self, folder: Path, name: str = "") -> None:
        self.folder = folder
        self.name = name or clip_name(folder.resolve().name)
        self.paths = images_in(folder)
        if not self.paths:
            raise DataError(folder, "contains no images; specify the folder with the frames of a clip")
        self.count = len(self.paths)
        self.size = image_size(self.paths[0])

    def frames(self) -> Iterator[Frame]:
        for path in self.paths:
            frame = read_image(path)
            if frame.shape[:2] != self.size:
                first = f"{self.size[0]}x{self.size[1]}"
                raise DataError(path, f"{frame.shape[0]}x{frame.shape[1]}, but the first image of the clip is {first}")
            yield frame

    def describe(self) -> dict[str, Any]:
        return {"kind": "pictures", "first": self.paths[0].name, "last": self.paths[-1].name}


class VideoFile:
    """The video stream of a file; audio is ignored, rotation is applied, and higher bit depths are reduced to 8
    bits.
    """

    def __init__(self, path: Path, evenly: bool = False) -> None:
        self.path = path
        self.name = clip_name(path.stem)
        self._reader = VideoReader(path)
        self.count, self.fps = len(self._reader), self._reader.rate
        self.variable = _variable(self._reader.times, self._reader.tick)
        if self.variable and not evenly:
            low, high = self.variable
            gaps = f"{low * 1000:.1f} to {high * 1000:.1f} ms between frames"
            advice = f"convert it to a constant rate, or prepare it with --fps {float(self.fps or 30):.4g}"
            raise DataError(path, f"variable frame rate ({gaps}); {advice}")
        height, width = self._reader.frame(0).shape[:2]
        self.size = height, width

    def frames(self) -> Iterator[Frame]:
        for index in range(self.count):
            frame = self._reader.frame(index)
            if frame.shape[:2] != self.size:
                raise DataError(self.path, f"the frame size changes at frame {index}; split the file there")
            yield frame

    def describe(self) -> dict[str, Any]:
        return {
            "kind": "video",
            "file": self.path.name,
            "codec": self._reader.codec,
            "pixels": self._reader.pixels,
            **({"transfer": self._reader.transfer} if self._reader.transfer else {}),
            "fps": None if self.fps is None else str(self.fps),
            "variable_rate": bool(self.variable),
        }


def clip_name(stem: str) -> str:
    r"""Return the name of a clip, which is also that of its folder, from the name of its file or folder without suffix.

    >>> clip_name(".walk"), clip_name("..."), clip_name("a\\b"), len(clip_name("x" * 250))
    ('walk', 'clip', 'a_b', 160)
    """
    name = stem.lstrip(".").replace("\\", "_")
    return name.encode(errors="ignore")[:_LONGEST_NAME].decode(errors="ignore") or "clip"


def _variable(times: list[int], tick: Fraction) -> tuple[float, float] | None:
    """Return the shortest and longest frame interval in seconds if they differ by more than tick rounding, else None.

    >>> _variable([0, 33, 67, 100, 133], Fraction(1, 1000)) is None
    True
    >>> _variable([0, 33, 67, 133], Fraction(1, 1000))
    (0.033, 0.066)
    """
    gaps = [later - earlier for earlier, later in pairwise(times)]
    if not gaps or max(gaps) - min(gaps) <= max(2, 0.02 * min(gaps)):
        return None
    return float(min(gaps) * tick), float(max(gaps) * tick)

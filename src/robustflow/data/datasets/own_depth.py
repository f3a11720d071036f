"""A user's depth maps, `--depth DIR`: the map of a frame `clip/frame_0001.png` is `DIR/clip/frame_0001` or
`DIR/frame_0001` with the extension .png (16-bit grey, millimetres), .npy or .pfm (metres), unless `--depth-unit` states
the unit. Pixels without a measurement are zero, NaN or infinite.
"""

from __future__ import annotations

import hashlib
import re
from functools import cached_property
from pathlib import Path

import numpy as np

from ...core.errors import DataError, UsageError
from ...core.paths import refuse_backslashes, user_path
from ...core.types import Camera, Sample, SceneDepth
from ...media.arrays import readable
from ...media.depth import Values, read_depth_npy, read_depth_pfm, read_depth_png
from ...media.images import IMAGE_SUFFIXES
from .dataset import Dataset
from .depth import scene_depth
from .still import SharesFrames

_READERS = {".png": read_depth_png, ".npy": read_depth_npy, ".pfm": read_depth_pfm}
_FOLDERS = 3
"""Maximum number of parent folders of a frame that DIR may mirror."""
_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
_FARTHEST = 500.0
"""Largest plausible median depth of a user's map, in metres; that of a room is larger if it is in millimetres."""


class OwnDepth:
    """Depth maps for the frames of a dataset. Implements `Depths`."""

    def __init__(
        self, folder: str | Path, dataset: Dataset, focal: float | None = None, unit: str | None = None
    ) -> None:
        self._folder, self._dataset = user_path(folder), dataset
        if not self._folder.is_dir():
            raise UsageError("--depth", f"{self._folder} does not exist; give the folder with a map for every frame")
        refuse_backslashes(self._folder)
        if focal is not None and (isinstance(focal, bool | str) or not 0 < focal < float("inf")):
            raise UsageError("--focal", f"{focal} is invalid; give a positive focal length in pixels")
        self._focal, self._per_metre = focal, None if unit is None else _per_metre(unit)

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The principal point is the centre of the frame; the camera motion is unknown."""
        height, width = sample.shape
        focal = float(max(width, height)) if self._focal is None else float(self._focal)
        first, second = (self._read(path) for path in self._maps(sample.key))
        camera = Camera((focal, focal), ((width - 1) / 2, (height - 1) / 2))
        return scene_depth(first, second, camera, self._folder, sample, _FARTHEST)

    def depth_files(self, key: str) -> list[Path]:
        return list(dict.fromkeys(self._maps(key)))

    @cached_property
    def digest(self) -> str:
        stated = self._focal if self._per_metre is None else (self._focal, self._per_metre)
        whole = hashlib.blake2b(repr(stated).encode(), digest_size=8)
        for key in list(self._dataset.keys()):
            for frame in self._frames(key):
                path = self._map(frame)
                if path is not None:
                    with readable(path), open(path, "rb") as file:
                        whole.update(hashlib.file_digest(file, hashlib.blake2b).digest())
        return whole.hexdigest()

    def _maps(self, key: str) -> tuple[Path, Path]:
        paths = []
        for frame in self._frames(key):
            path = self._map(frame)
            if path is None:
                names = f"{frame.stem} with {' or '.join(_READERS)}, here or in {frame.parent.name}/"
                raise DataError(self._folder, f"no depth map for {frame}; expected {names}")
            if (other := self._owners.get(path)) is not None and other != frame:
                raise DataError(path, f"matches {other} and {frame}; put the maps into folders named like the frames'")
            paths.append(path)
        return paths[0], paths[1]

    @cached_property
    def _owners(self) -> dict[Path, Path]:
        owners: dict[Path, Path] = {}
        for key in list(self._dataset.keys()):
            for frame in self._frames(key):
                if (path := self._map(frame)) is not None:
                    owners.setdefault(path, frame)
        return owners

    def _frames(self, key: str) -> tuple[Path, ...]:
        dataset = self._dataset
        names = dataset.frame_names(key) if isinstance(dataset, SharesFrames) else tuple(dataset.files(key)[:2])
        frames = tuple(Path(name) for name in names if isinstance(name, Path))
        if len(frames) != 2 or any(frame.suffix.lower() not in IMAGE_SUFFIXES for frame in frames):
            raise UsageError("--depth", f"maps are named like images, but the files of '{dataset.name}' are not images")
        return frames

    def _map(self, frame: Path) -> Path | None:
        above = frame.parent.relative_to(frame.anchor).parts[-_FOLDERS:]
        places = [self._folder.joinpath(*above[start:]) for start in range(len(above) + 1)]
        named = (place / f"{frame.stem}{suffix}" for place in places for suffix in _READERS)
        return next((path for path in named if path.is_file() and not path.samefile(frame)), None)

    def _read(self, path: Path) -> Values:
        """Return a map in metres."""
        values = _READERS[path.suffix](path)
        default = _PER_METRE["mm" if path.suffix == ".png" else "m"]
        return values / np.float32(default if self._per_metre is None else self._per_metre)


def _per_metre(unit: str) -> float:
    """Return how many of a unit are one metre.

    >>> _per_metre("mm"), _per_metre("m/5000")
    (1000.0, 5000.0)
    """
    number = re.fullmatch(r"m/(\d{1,9}(?:\.\d{1,9})?)", str(unit))
    per_metre = float(number[1]) if number else _PER_METRE.get(str(unit), 0.0)
    if per_metre <= 0:
        raise UsageError("--depth-unit", f"{unit!r} is not a unit; give m, cm, mm, or m/N for N per metre, e.g. m/5000")
    return per_metre

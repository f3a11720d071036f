"""What a user brings: a dataset `module.path:Attribute`, checked and identified by its source; and depth maps.

`--depth DIR`: the map of a frame `clip/frame_0001.png` is `DIR/clip/frame_0001` or `DIR/frame_0001` with the extension
.png (16-bit grey, millimetres), .npy or .pfm (metres), unless `--depth-unit` states the unit. Pixels without a
measurement are zero, NaN or infinite.
"""

from __future__ import annotations

import hashlib
import inspect
import re
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import DataError, UsageError
from ...core.files import digest_of_bytes
from ...core.paths import refuse_backslashes, user_path
from ...core.plugins import called, check_options, import_target, source_of_target
from ...core.source_digest import source_digest
from ...core.types import Camera, Sample, SceneDepth
from ...media.arrays import readable
from ...media.depth import Values, read_depth_npy, read_depth_pfm, read_depth_png
from ...media.images import IMAGE_SUFFIXES
from .base import Dataset
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
        found = []
        for frame in self._frames(key):
            path = self._map(frame)
            if path is None:
                names = f"{frame.stem} with {' or '.join(_READERS)}, here or in {frame.parent.name}/"
                raise DataError(self._folder, f"no depth map for {frame}; expected {names}")
            if (other := self._owners.get(path)) is not None and other != frame:
                raise DataError(path, f"matches {other} and {frame}; put the maps into folders named like the frames'")
            found.append(path)
        return found[0], found[1]

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


_GUIDE = "see the guide 'add your dataset'"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")


def open_own_dataset(target: str, options: dict[str, Any]) -> Dataset:
    dataset = import_target(target, "dataset")
    if inspect.isclass(dataset) or inspect.isroutine(dataset):
        check_options(dataset, target, options, "-D")
        opener = dataset
        dataset = called(target, "its constructor", lambda: opener(**options))
    elif options:
        raise UsageError(target, f"a dataset object does not accept options; omit {', '.join(options)}")
    check_members(dataset, target)
    return dataset


def check_members(dataset: Any, what: str) -> None:
    for member in ("name", "has_flow", "keys", "load", "files"):
        if not hasattr(dataset, member):
            raise UsageError(what, f"not a dataset: it has no '{member}'; {_GUIDE}")
    if not isinstance(dataset.name, str) or not _NAME.fullmatch(dataset.name):
        raise UsageError(what, f"the name {dataset.name!r} is invalid: use only letters, digits, '_' and '-'")
    keys = called(what, "keys()", dataset.keys)
    if not isinstance(keys, list) or not keys or not all(isinstance(key, str) and key for key in keys):
        raise UsageError(what, f"keys() must return a non-empty list of strings, not {keys!r:.60}")
    if len(set(keys)) != len(keys):
        raise UsageError(what, f"keys() returns '{next(k for k in keys if keys.count(k) > 1)}' twice")
    check_sample(dataset, keys[0], what)


def load_checked(dataset: Any, key: str, what: str = "") -> Sample:
    what = what or f"the dataset '{dataset.name}'"
    sample = called(what, f"load('{key}')", lambda: dataset.load(key))
    if not isinstance(sample, Sample):
        raise UsageError(what, f"load('{key}') returned {type(sample).__name__}; it must return a Sample")
    if sample.key != key:
        raise UsageError(what, f"load('{key}') returned the sample '{sample.key}'")
    if (sample.flow is not None) != bool(dataset.has_flow):
        state = "has ground truth" if sample.flow is not None else "has no ground truth"
        raise UsageError(what, f"has_flow is {dataset.has_flow}, but sample '{key}' {state}")
    return sample


def check_sample(dataset: Any, key: str, what: str) -> Sample:
    sample = load_checked(dataset, key, what)
    files = called(what, f"files('{key}')", lambda: dataset.files(key))
    if not isinstance(files, list) or not all(isinstance(path, Path) and path.is_file() for path in files):
        raise UsageError(what, f"files('{key}') must return the paths of existing files, not {files!r:.80}")
    return sample


def own_source(target: str, made: object) -> str:
    """Return a hash (16 hexadecimal digits) of the source of a user's object: its class, and the target's module."""
    return digest_of_bytes(source_digest(type(made)).encode(), source_of_target(target) or b"", size=8)

"""User-provided depth maps for a dataset: `--depth DIR`.

The map of a frame `clip/frame_0001.png` is `DIR/clip/frame_0001` or `DIR/frame_0001` with the extension .png (16-bit
grey, millimetres), .npy or .pfm (metres). Pixels without a measurement are zero, NaN or infinite.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import DataError, UsageError
from ..flowio.arrays import readable
from ..flowio.depth import Values, read_depth_npy, read_depth_pfm, read_depth_png
from ..images.folder import IMAGE_SUFFIXES
from ..layout import user_path
from ..sample import Camera, Sample, SceneDepth
from .base import Dataset
from .depth import scene_depth
from .still import SharesFrames

_READERS = {".png": read_depth_png, ".npy": read_depth_npy, ".pfm": read_depth_pfm}
_FOLDERS = 3
"""Maximum number of parent folders of a frame that DIR may mirror."""


class OwnDepth:
    """Depth maps for the frames of a dataset. Implements `Depths`."""

    def __init__(self, folder: str | Path, dataset: Dataset, focal: float | None = None) -> None:
        self._folder, self._dataset = user_path(folder), dataset
        if not self._folder.is_dir():
            raise UsageError(f"--depth {self._folder}: no such folder; give the folder with a map for every frame")
        if focal is not None and (isinstance(focal, bool | str) or not 0 < focal < float("inf")):
            raise UsageError(f"--focal {focal}: give a positive focal length in pixels")
        self._focal = focal

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The principal point is the centre of the frame; the camera motion is unknown."""
        height, width = sample.shape
        focal = float(max(width, height)) if self._focal is None else float(self._focal)
        first, second = (_read(path) for path in self._maps(sample.key))
        camera = Camera((focal, focal), ((width - 1) / 2, (height - 1) / 2))
        return scene_depth(first, second, camera, self._folder, sample)

    def depth_files(self, key: str) -> list[Path]:
        """See `Depths.depth_files`."""
        return list(dict.fromkeys(self._maps(key)))

    @cached_property
    def digest(self) -> str:
        """Return a hash (16 hexadecimal digits) of the maps of all samples and of the focal length."""
        whole = hashlib.blake2b(repr(self._focal).encode(), digest_size=8)
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
                raise DataError(
                    f"{self._folder}: no depth map for {frame}; expected {frame.stem} with the extension "
                    f"{', '.join(_READERS)}, in the folder itself or in {frame.parent.name}/"
                )
            if (other := self._owners.get(path)) is not None and other != frame:
                raise DataError(
                    f"{path}: matches both {other} and {frame}; put the maps into folders named like the "
                    "folders of the frames"
                )
            found.append(path)
        return found[0], found[1]

    @cached_property
    def _owners(self) -> dict[Path, Path]:
        """Return, for each map, the first frame that uses it."""
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
            raise UsageError(
                f"--depth needs maps named like the files of the frames, but the files of '{dataset.name}' are "
                "not images; give a folder of images"
            )
        return frames

    def _map(self, frame: Path) -> Path | None:
        above = frame.parent.relative_to(frame.anchor).parts[-_FOLDERS:]
        places = [self._folder.joinpath(*above[start:]) for start in range(len(above) + 1)]
        named = (place / f"{frame.stem}{suffix}" for place in places for suffix in _READERS)
        return next((path for path in named if path.is_file() and not path.samefile(frame)), None)


def _read(path: Path) -> Values:
    values = _READERS[path.suffix](path)
    return values / np.float32(1000) if path.suffix == ".png" else values

"""The key frames of a prepared clip under the five corruptions that require an entire clip.

Object motion blur averages 2c + 1 master frames around a key frame (paper appendix, "Object Motion Blur"); a rolling
shutter takes each row from the master frame at the row's readout time. Video corruptions transcode the master once per
severity; the key frames are stored in a cache of limited size.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import DataError
from ...core.files import make_folder, sealed, sha256_of_file, unsealed, write_json
from ...core.types import Frame
from .clip import ClipFile, ClipReader
from .codec import i420_to_rgb
from .prepared import FolderCache, PreparedClip
from .variants import FRAMES_FILE, make_variant


def rolling_frames(frame_at: Callable[[int], Frame], centre: int, readouts: Sequence[int]) -> dict[int, Frame]:
    """Compute a key frame for several readout times, in one pass over the longest readout."""
    reach = (max(readouts) + 1) // 2
    frames: dict[int, Frame] = {}
    for index in range(centre - reach, centre + reach + 1):
        frame = frame_at(index)
        for readout in dict.fromkeys(readouts):
            rows = row_offsets(frame.shape[0], readout) == index - centre
            frames.setdefault(readout, np.empty_like(frame))[rows] = frame[rows]
    return frames


def row_offsets(height: int, readout: int) -> np.ndarray:
    return (readout * (2 * np.arange(height) + 1 - height) + height) // (2 * height)


def mean_of_windows(frame_at: Callable[[int], Frame], centre: int, reaches: Sequence[int]) -> dict[int, Frame]:
    """Compute the mean over [centre - c, centre + c] for every c in `reaches`, in one pass over the longest window."""
    reaches = tuple(dict.fromkeys(reaches))
    longest = max(reaches)
    sums: dict[int, np.ndarray] = {}
    for index in range(centre - longest, centre + longest + 1):
        frame = frame_at(index)
        for reach in reaches:
            if abs(index - centre) <= reach:
                if reach not in sums:
                    sums[reach] = frame.astype(np.uint32)
                else:
                    sums[reach] += frame
    counts = {reach: 2 * reach + 1 for reach in reaches}
    return {reach: ((2 * sums[reach] + n) // (2 * n)).astype(np.uint8) for reach, n in counts.items()}


RECORDS_FOLDER = ".records"

_Make = Callable[[Callable[[int], Frame], int, Sequence[int]], dict[int, Frame]]

_AROUND: dict[str, _Make] = {"object_motion_blur": mean_of_windows, "rolling_shutter": rolling_frames}
"""Functions that compute a key frame, at all parameters at once, from the surrounding master frames."""


class OpenClip:
    """Readers for the master of a clip and for the key frames of each variant."""

    def __init__(self, clip: PreparedClip, cache: FolderCache, parameters: Mapping[str, tuple[int, ...]]) -> None:
        self.clip = clip
        self._cache = cache
        self._master = ClipReader(clip.master)
        self._around = {name: self._key_frames(make, parameters[name]) for name, make in _AROUND.items()}
        self._variants: dict[tuple[str, int], ClipReader] = {}

    def corrupted(self, index: int, corruption: str, parameter: int) -> Frame:
        """Return a corrupted key frame, RGB uint8 (H, W, 3); video corruptions transcode the clip on first use."""
        if corruption not in self._around:
            return self._transcoded(index, corruption, parameter)
        check_master(self.clip)
        return self._around[corruption](index)[parameter]

    def _key_frames(self, make: _Make, parameters: Sequence[int]) -> Callable[[int], dict[int, Frame]]:
        """Return a function that computes a key frame at all parameters; each key frame belongs to two pairs, so the
        latest ones are cached."""
        return lru_cache(maxsize=3)(lambda index: make(lambda at: self._rgb(self._master, at), index, parameters))

    def _transcoded(self, index: int, corruption: str, parameter: int) -> Frame:
        position = self.clip.manifest.key_frames.index(index)
        reader = self._variants.get((corruption, parameter))
        if reader is None:
            check_master(self.clip)
            name = _variant_name(self.clip, corruption, parameter)
            make = partial(self._make, corruption, parameter)
            reader = self._cache.use(name, make, partial(self._reader, position))
            self._variants[corruption, parameter] = reader
        return self._rgb(reader, position)

    def _make(self, corruption: str, parameter: int, folder: Path) -> None:
        record = make_variant(self.clip, corruption, parameter, folder)
        path = record_of_variant(self.clip, self._cache, corruption, parameter)
        make_folder(path.parent)
        write_json(path, sealed(record))
        for warning in record["warnings"]:
            warnings.warn(warning, stacklevel=2)

    def _reader(self, position: int, folder: Path) -> ClipReader:
        master = self.clip.master
        count = len(self.clip.manifest.key_frames)
        reader = ClipReader(ClipFile(folder / FRAMES_FILE, count, master.fps, master.height, master.width), keep=2)
        reader.picture(position)  # opens the file, so that it can be read even after eviction
        return reader

    def _rgb(self, reader: ClipReader, index: int) -> Frame:
        return i420_to_rgb(reader.picture(index), reader.clip.height, reader.clip.width)


def check_master(clip: PreparedClip) -> None:
    """Verify the hash of a clip's master, once per process: it takes about a second per gigabyte."""
    path = clip.master.path
    try:
        about = path.stat()
        intact = _sha256(path, about.st_mtime_ns, about.st_size) == clip.manifest.master_sha256
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); prepare the clip again") from error
    if not intact:
        raise DataError(path, "damaged (its SHA-256 differs); delete its folder and prepare the clip again")


@cache
def _sha256(path: Path, changed: int, size: int) -> str:
    return sha256_of_file(path)


def read_record(path: Path) -> dict[str, Any]:
    content = unsealed(path.read_bytes())
    if content is None:
        raise DataError(path, f"damaged; delete it and {path.parents[1] / path.stem}; both will be recreated")
    record: dict[str, Any] = json.loads(content)
    return record


def record_of_variant(clip: PreparedClip, cache: FolderCache, corruption: str, parameter: int) -> Path:
    return cache.root / RECORDS_FOLDER / f"{_variant_name(clip, corruption, parameter)}.json"


def _variant_name(clip: PreparedClip, corruption: str, parameter: int) -> str:
    return f"{clip.name}-{clip.manifest.master_sha256[:12]}-{corruption}-{parameter}"

"""A video file as a dataset: frames decoded as they are asked for, in constant memory."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path

from ..errors import DataError, UsageError
from ..layout import positive
from ..sample import Frame, Sample
from ..video.reader import VideoReader


class Video:
    """Pairs of frames `step` apart; keys are frame numbers from "000000". One group, for frames of a video are
    not independent. Implements `Dataset` and `Clips`.

    The two frames of a pair come from two readers, so that walking through the keys in order decodes each frame
    twice at most and keeps two frames in memory whatever the step. Every frame around the pair that is asked for
    has one more reader.

    Raises:
        DataError: no video, a damaged one, or fewer than `step` + 1 frames.
    """

    name = "folder"
    has_flow = False

    def __init__(self, path: Path, step: int = 1) -> None:
        self._path, self._step = path, positive("step", step)
        self._first, self._second = VideoReader(path), VideoReader(path)
        count = len(self._first) - step
        if count < 1:
            raise DataError(f"{path}: {len(self._first)} frame(s), but pairs at a step of {step} need {step + 1}")
        self._keys = [f"{index:06d}" for index in range(count)]
        self._around: dict[int, VideoReader] = {}

    def keys(self) -> list[str]:
        """See `Dataset.keys`."""
        return list(self._keys)

    def files(self, key: str) -> list[Path]:
        """See `Dataset.files`."""
        self._index(key)
        return [self._path]

    def load(self, key: str) -> Sample:
        """See `Dataset.load`."""
        index = self._index(key)
        frames = (self._first.frame(index), self._second.frame(index + self._step))
        return Sample(key, frames, group=self._path.stem)

    def around(self, key: str, reach: int) -> range:
        """See `Clips.around`."""
        index = self._index(key)
        last = (len(self._first) - 1 - index) // self._step
        return range(-min(reach, index // self._step), min(reach + 1, last) + 1)

    def frame(self, key: str, offset: int) -> Frame:
        """See `Clips.frame`."""
        if offset not in self._around:
            self._around[offset] = copy(self._first)  # a copy opens the file anew
        return self._around[offset].frame(self._index(key) + offset * self._step)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """See `Clips.frame_files`."""
        return self.files(key)

    def _index(self, key: str) -> int:
        if not (key.isascii() and key.isdigit() and int(key) < len(self._keys) and self._keys[int(key)] == key):
            raise UsageError(f"{self._path} has no sample '{key}'; keys go from '000000' to '{self._keys[-1]}'")
        return int(key)

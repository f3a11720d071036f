"""A video file as a dataset: frames are decoded on demand, in constant memory."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path

from ..errors import UsageError
from ..layout import positive
from ..sample import Frame, Sample
from ..video.reader import VideoReader
from .pairs import too_few_frames
from .samples import Samples
from .section import Position, position


class Video(Samples):
    """A dataset of pairs of video frames `step` apart; keys are frame numbers from "000000". All pairs form one group,
    because frames of a video are not independent. Implements `Dataset` and `Clips`.
    """

    name = "folder"
    has_flow = False

    def __init__(self, path: Path, step: int = 1, start: Position = None, stop: Position = None) -> None:
        self._path, self._step = path, positive("step", step)
        self._first, self._second = VideoReader(path), VideoReader(path)
        begin, end = self._frame_number("start", start, 0), self._frame_number("stop", stop, len(self._first))
        self._end = min(end, len(self._first))
        if self._end - begin <= step:
            count = max(0, self._end - begin)
            raise too_few_frames(count, step, path, len(self._first))
        self._begin = begin
        self._keys = [f"{index:06d}" for index in range(begin, self._end - step)]
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
        last = (self._end - 1 - index) // self._step
        return range(-min(reach, (index - self._begin) // self._step), min(reach + 1, last) + 1)

    def frame(self, key: str, offset: int) -> Frame:
        """See `Clips.frame`."""
        if offset not in self._around:
            self._around[offset] = copy(self._first)  # a copy reopens the file
        return self._around[offset].frame(self._index(key) + offset * self._step)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """See `Clips.frame_files`."""
        return self.files(key)

    def frame_names(self, key: str) -> tuple[int, int]:
        """See `SharesFrames.frame_names`."""
        index = self._index(key)
        return index, index + self._step

    def _index(self, key: str) -> int:
        number = int(key) - self._begin if key.isascii() and key.isdigit() and len(key) < 12 else -1
        if not 0 <= number < len(self._keys) or self._keys[number] != key:
            raise UsageError(
                f"{self._path} has no sample '{key}'; keys go from '{self._keys[0]}' to '{self._keys[-1]}'"
            )
        return int(key)

    def _frame_number(self, option: str, value: Position, default: int) -> int:
        chosen = position(option, value)
        if chosen is None:
            return default
        return self._first.index_at(chosen) if isinstance(chosen, float) else chosen

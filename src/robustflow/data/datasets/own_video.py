"""Your own video as a film of numbered frames, decoded on demand in constant memory."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import Any

from ...core.types import Frame, Sample
from ..video.reader import VideoReader
from .arrangement import Arrangement
from .frame_names import Film
from .own_frames import OwnFrames
from .pair_files import Position, position


class OwnVideo(OwnFrames):
    """Pairs of frames of a video. Keys are frame numbers from "000000"."""

    def __init__(self, path: Path, start: Position, stop: Position, step: int, gaps: str) -> None:
        reader = VideoReader(path)
        self._readers = {0: reader}  # by offset: each decodes forward
        total = len(reader)
        times = tuple(reader.times) if len(set(reader.times)) == total else ()
        begin, end = self._frame_number("start", start, 0), self._frame_number("stop", stop, total)
        film = Film(tuple(range(total)), times, timed=True)
        super().__init__(path, Arrangement([("", film)]), range(begin, min(end, total)), step, gaps)

    def read(self, frame: Any, offset: int = 0) -> Frame:
        if offset not in self._readers:
            self._readers[offset] = copy(self._readers[0])  # a copy reopens the file
        return self._readers[offset].frame(frame)

    def files(self, key: str) -> list[Path]:
        self.pair(key)
        return [self.where]

    def load(self, key: str) -> Sample:
        pair = self.pair(key)
        frames = tuple(self.read(frame, offset) for offset, frame in enumerate(pair.frames))
        return Sample(key, frames, group=pair.group)

    def frame(self, key: str, offset: int) -> Frame:
        return self.read(self.frames_around(key, [offset])[0], offset)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.files(key)

    def _key(self, folder: str, frame: Any) -> str:
        return f"{frame:06d}"

    def _group(self, folder: str, first: Any) -> str:
        return self.where.stem

    def _frame_number(self, option: str, value: Position, default: int) -> int:
        chosen = position(option, value)
        if chosen is None:
            return default
        return self._readers[0].index_at(chosen) if isinstance(chosen, float) else chosen

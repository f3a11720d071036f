"""Frames of a video by number: forward decoding where that is near, a jump to a key frame where it is not.

The list of frames comes from the container's packets, without decoding, and is checked by decoding the first frame
and everything after the last key frame. Where that check fails (no or repeated time stamps, two packets per frame,
an end that was cut off) the whole file is decoded once instead and frames are counted.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from ..errors import DataError
from ..sample import Frame

_NEAR = 48
"""Frames worth decoding forward rather than seeking."""


class VideoReader:
    """Random access to the frames of a video's first video stream, as stored (a rotation tag is not applied).

    Holds one decoded frame and an open file. Can be pickled, and survives a fork: the copy opens the file anew.

    Raises:
        DataError: not a video, damaged, or without a video stream.
    """

    _container: Any
    _frames: Iterator[Any] | None
    _image: Frame | None
    _position: int
    _pid: int

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._close()
        self._stamps: list[int] = []
        self._key_stamps: list[int] = []
        self._count = 0
        self._call(self._index)

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int) -> Frame:
        """Frame number `index`, RGB uint8 (H, W, 3).

        Raises:
            DataError: it cannot be decoded.
        """
        if not 0 <= index < self._count:
            raise IndexError(f"{self._path} has frames 0 to {self._count - 1}, not {index}")
        if self._pid != os.getpid():
            self._close()
        if self._image is None or index != self._position:
            self._image = self._call(self._decode, index)
        return self._image.copy()

    def __getstate__(self) -> dict[str, Any]:
        transient = {"_container": None, "_frames": None, "_image": None, "_position": -1, "_pid": -1}
        return {**self.__dict__, **transient}

    def _close(self) -> None:
        self._container = None
        self._frames = None
        self._position = -1
        self._image = None
        self._pid = os.getpid()

    def _call(self, step: Any, *arguments: Any) -> Any:
        try:
            return step(*arguments)
        except (FFmpegError, OSError, ValueError) as error:
            self._close()
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise DataError(f"{self._path}: not a readable video ({reason}); check or convert the file") from error

    def _open(self) -> None:
        self._close()
        self._container = av.open(str(self._path))
        if not self._container.streams.video:
            raise ValueError("it has no video stream")
        self._frames = iter(self._container.decode(video=0))

    def _index(self) -> None:
        stamps, keys = [], []
        with av.open(str(self._path)) as container:
            if not container.streams.video:
                raise ValueError("it has no video stream")
            for packet in container.demux(video=0):
                if packet.size and not packet.is_discard:
                    stamps.append(packet.pts)
                    if packet.is_keyframe:
                        keys.append(packet.pts)
        if None not in stamps and len(set(stamps)) == len(stamps) and keys:
            self._stamps, self._key_stamps = sorted(stamps), sorted(keys)
            self._count = len(stamps)
            if self._holds():
                return
        self._stamps = self._key_stamps = []
        self._open()
        self._count = sum(1 for _ in self._frames or ())
        self._close()
        if not self._count:
            raise ValueError("no frame can be decoded")

    def _holds(self) -> bool:
        """Whether the packets tell the truth about the first frame and about the end."""
        last = self._key_stamps[-1]
        try:
            self._open()
            first = next(self._frames or iter(()), None)
            self._container.seek(last, stream=self._container.streams.video[0])
            tail = [frame.pts for frame in self._container.decode(video=0)]
        except FFmpegError:
            return False
        finally:
            self._close()
        expected = [stamp for stamp in self._stamps if stamp >= last]
        starts = first is not None and first.pts == self._stamps[0]
        return starts and None not in tail and [stamp for stamp in tail if stamp >= last] == expected

    def _decode(self, index: int) -> Frame:
        forward = self._frames is not None and self._position < index
        if not forward or (self._stamps and index - self._position > _NEAR):
            self._start(index)
        for frame in self._frames or ():
            number = self._number(frame)
            self._position = number
            if number == index:
                return np.ascontiguousarray(frame.to_ndarray(format="rgb24"))
            if number > index:
                break
        raise ValueError(f"frame {index} cannot be decoded")

    def _start(self, index: int) -> None:
        """Open the file, at the last key frame not after `index` where seeking is possible."""
        if self._container is None:
            self._open()
        if not self._stamps:
            self._open()
            return
        key = self._key_stamps[max(bisect_right(self._key_stamps, self._stamps[index]) - 1, 0)]
        self._container.seek(key, stream=self._container.streams.video[0])
        self._frames = iter(self._container.decode(video=0))
        first = next(self._frames, None)
        if first is None or first.pts > self._stamps[index]:  # the container's index led past it
            self._open()
        else:
            self._frames = _again(first, self._frames)
        self._position = -1

    def _number(self, frame: Any) -> int:
        if not self._stamps:
            return self._position + 1
        return bisect_right(self._stamps, frame.pts) - 1


def _again(first: Any, rest: Iterator[Any]) -> Iterator[Any]:
    yield first
    yield from rest

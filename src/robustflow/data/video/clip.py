"""Write and read RobustFlow's clips: MP4 files with one H.264 stream of known length and constant frame rate.

Clips are written atomically. They are read as packets (to damage them or to decode from the start) or by frame index.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from ...core.errors import DataError
from .codec import I420, Decoder, Options, Packet, configure, even_size, video_frame


@dataclass(frozen=True)
class ClipFile:
    """A clip on disk; `height` and `width` are the frame size before padding to even sides."""

    path: Path
    count: int
    fps: Fraction
    height: int
    width: int

    @property
    def stored_size(self) -> tuple[int, int]:
        return even_size(self.height, self.width)


def write_clip(
    path: Path, pictures: Iterable[I420], size: tuple[int, int], fps: Fraction, options: Options
) -> ClipFile:
    temporary = path.with_name(f".{path.name}.part")
    height, width = even_size(*size)
    count = 0
    # omit FFmpeg's version, so that the same frames and encoder always result in the same file
    with av.open(str(temporary), "w", format="mp4", options={"fflags": "+bitexact"}) as container:
        stream: Any = container.add_stream("libx264", rate=fps)
        configure(stream.codec_context, height, width, fps, options)
        for picture in pictures:
            container.mux(stream.encode(video_frame(picture, count, fps)))
            count += 1
        if not count:
            raise DataError(path.name, "no frames to encode")
        container.mux(stream.encode(None))
    temporary.replace(path)
    return ClipFile(path, count, fps, *size)


def read_header(clip: ClipFile) -> bytes:
    with _open(clip) as container:
        return bytes(container.streams.video[0].codec_context.extradata or b"")


def read_packets(clip: ClipFile, start: int = 0) -> Iterator[Packet]:
    """Yield packets in file order, starting at the last packet from which frame `start` can be decoded."""
    with _open(clip) as container:
        stream = container.streams.video[0]
        if start:
            container.seek(int(start / clip.fps / stream.time_base), stream=stream)
        try:
            for packet in container.demux(stream):
                if packet.size and packet.pts is not None:
                    yield Packet(bytes(packet), round(packet.pts * stream.time_base * clip.fps))
        except av.error.FFmpegError as error:
            raise _damaged(clip, error) from error


def read_pictures(clip: ClipFile, start: int = 0) -> Iterator[tuple[int, I420]]:
    decoder = Decoder(read_header(clip), *clip.stored_size)
    expected = start
    for index, picture in decoder.decode(read_packets(clip, start)):
        if index < expected:
            continue
        if index != expected:
            break
        yield index, picture
        expected += 1
    if expected != clip.count:
        raise _damaged(clip, f"{clip.count} frames expected, frame {expected} cannot be read")


class ClipReader:
    """Random access to the frames of a clip. Reading forwards decodes each frame once; reading backwards seeks."""

    def __init__(self, clip: ClipFile, keep: int = 64) -> None:
        self.clip = clip
        self._keep = keep
        self._recent: OrderedDict[int, I420] = OrderedDict()
        self._rest: Iterator[tuple[int, I420]] | None = None
        self._next = 0

    def __getstate__(self) -> dict[str, Any]:
        return {"clip": self.clip, "_keep": self._keep, "_recent": OrderedDict(), "_rest": None, "_next": 0}

    def picture(self, index: int) -> I420:
        """Return frame `index` as I420; callers must not modify it."""
        if not 0 <= index < self.clip.count:
            raise IndexError(f"{self.clip.path.name} has frames 0 to {self.clip.count - 1}, but no frame {index}")
        if index in self._recent:
            return self._recent[index]
        # a seek goes back to the start of a group of pictures (250 frames); decoding forward is faster for short steps
        if self._rest is None or not self._next <= index < self._next + 250:
            self._rest, self._next = read_pictures(self.clip, index), index
        for number, picture in self._rest:
            self._next = number + 1
            self._recent[number] = picture
            if len(self._recent) > self._keep:
                self._recent.popitem(last=False)
            if number == index:
                return picture
        raise _damaged(self.clip, f"frame {index} cannot be read")


def _open(clip: ClipFile) -> Any:
    try:
        return av.open(str(clip.path), format="mp4")
    except (av.error.FFmpegError, OSError) as error:
        raise _damaged(clip, error) from error


def _damaged(clip: ClipFile, why: object) -> DataError:
    return DataError(clip.path, f"differs from the prepared clip ({why}); delete its folder and prepare it again")

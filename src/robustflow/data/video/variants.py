"""Corrupt a clip with H.264 CRF, H.264 ABR or Bit Error (paper appendix, "Video corruptions").

Bit Error applies FFmpeg's `noise` bitstream filter with an integer amount to the packets of the clip. For each byte,
`state += byte + 1` (uint32, initially 0, carried over between packets); if `state` is a multiple of the amount N, the
byte is replaced with the low byte of `state`. So about one byte in N is changed, and the positions are deterministic.

Damage can remove any frame from a stream. The reference code numbers the remaining frames in output order, so every
lost frame shifts all later frames by one. Here, each frame is placed according to its presentation time. As in a video
player, a lost frame is replaced with the previous frame, or with the first decoded frame if there is none.

A variant contains only the clip's key frames, as lossless, intra-coded yuv420p. It is created in a single pass over the
master, in constant memory.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.bitstream import BitStreamFilterContext

from ...core.errors import DataError
from ...core.files import make_folder
from ...core.types import Frame
from ...media.images import read_image
from .clip import ClipFile, read_header, read_packets, read_pictures, write_clip
from .codec import I420, Decoder, Encoder, Packet, abr, crf, encoder_versions, i420_to_rgb, lossless, rgb_to_i420
from .container import main_stream, open_video
from .prepared import PreparedClip


@dataclass
class Damage:
    """The effect of bit errors on a stream: counts and the display indices of the frames with damaged packets."""

    amount: int
    bytes_changed: int = 0
    frames_hit: list[int] = field(default_factory=list)


def damage_packets(packets: Iterable[Packet], damage: Damage) -> Iterator[Packet]:
    """Damage the packets of one stream, in file order."""
    noise = BitStreamFilterContext(f"noise={damage.amount}")
    for packet in packets:
        (filtered,) = noise.filter(av.Packet(bytearray(packet.data)))  # the filter writes into the memory it is given
        data = bytes(filtered)
        changed = np.count_nonzero(np.frombuffer(data, np.uint8) != np.frombuffer(packet.data, np.uint8))
        damage.bytes_changed += int(changed)
        if changed:
            damage.frames_hit.append(packet.index)
        yield Packet(data, packet.index)


REORDER = 32
"""Number of frames buffered to restore the display order; H.264 requires at most 16."""


@dataclass
class Fill:
    """A record of the lost frames of a clip and their replacements."""

    count: int
    lost: list[tuple[int, int, int]] = field(default_factory=list)
    dropped: int = 0

    @property
    def frames_lost(self) -> int:
        return sum(last - first + 1 for first, last, _ in self.lost)


def pictures_in_order(decoded: Iterable[tuple[int, I420]], fill: Fill) -> Iterator[tuple[int, I420]]:
    """Yield frames by ascending index without duplicates, using a bounded buffer."""
    waiting: list[tuple[int, int, I420]] = []
    last = -1
    for arrival, (index, picture) in enumerate(decoded):
        if index <= last or index >= fill.count or any(index == held[0] for held in waiting):
            fill.dropped += 1
            continue
        heapq.heappush(waiting, (index, arrival, picture))
        if len(waiting) > REORDER:
            last, _, earliest = heapq.heappop(waiting)
            yield last, earliest
    while waiting:
        last, _, earliest = heapq.heappop(waiting)
        yield last, earliest


def fill_lost(decoded: Iterable[tuple[int, I420]], fill: Fill) -> Iterator[tuple[int, I420]]:
    """Yield exactly `fill.count` frames with indices 0, 1, 2, ...; replace lost frames and record them in `fill`."""
    previous: tuple[int, I420] | None = None
    next_index = 0
    for index, picture in pictures_in_order(decoded, fill):
        if index > next_index:
            source, shown = previous or (index, picture)
            fill.lost.append((next_index, index - 1, source))
            for missing in range(next_index, index):
                yield missing, shown
        yield index, picture
        previous = (index, picture)
        next_index = index + 1
    if previous is None:
        raise DataError("stream", f"none of its {fill.count} frames can be decoded; choose a lower severity")
    if next_index < fill.count:
        source, shown = previous
        fill.lost.append((next_index, fill.count - 1, source))
        for missing in range(next_index, fill.count):
            yield missing, shown


FRAMES_FILE = "keyframes.mp4"


@dataclass
class Stream:
    """A corrupted master: its frames, and statistics that are complete once all frames have been read."""

    pictures: Iterator[tuple[int, I420]]
    decoder: Decoder
    fill: Fill
    damage: Damage | None = None
    bytes_coded: int = 0


def corrupted_stream(master: ClipFile, corruption: str, parameter: int) -> Stream:
    """Yield all frames of the master after a video corruption, in order and without gaps."""
    damage = None
    if corruption == "bit_error":
        damage, header = Damage(parameter), read_header(master)
        packets = damage_packets(read_packets(master), damage)
    else:
        options = {"h264_crf": crf, "h264_abr": abr}[corruption](parameter)
        encoder = Encoder(*master.stored_size, master.fps, options)
        header, packets = encoder.header, encoder.encode(read_pictures(master))
    stream = Stream(iter(()), Decoder(header, *master.stored_size), Fill(master.count), damage)

    def counted() -> Iterator[Packet]:
        for packet in packets:
            stream.bytes_coded += len(packet.data)
            yield packet

    stream.pictures = fill_lost(stream.decoder.decode(counted()), stream.fill)
    return stream


def make_variant(clip: PreparedClip, corruption: str, parameter: int, folder: Path) -> dict[str, Any]:
    make_folder(folder)
    master, keys = clip.master, clip.manifest.key_frames
    stream = corrupted_stream(master, corruption, parameter)
    remaining, changed = set(keys), 0

    def key_pictures() -> Iterator[I420]:
        nonlocal changed
        for index, picture in stream.pictures:
            if index in remaining:
                shown = i420_to_rgb(picture, master.height, master.width)
                changed += not (shown == read_image(clip.key_frame_path(index))).all()
                yield picture

    options = lossless("ultrafast", every_frame=True)
    write_clip(folder / FRAMES_FILE, key_pictures(), (master.height, master.width), master.fps, options)
    return _record(clip, corruption, parameter, stream, changed)


def warnings_of(record: dict[str, Any]) -> list[str]:
    where = f"{record['corruption']} (parameter {record['parameter']}) on {record['clip']}"
    if record["corruption"] == "bit_error" and not record["bytes_changed"]:
        return [f"{where}: none of {record['bytes_coded']} bytes was changed; the clip is too small for this severity"]
    if record["frames_lost"]:
        return [f"{where}: {record['frames_lost']} of {record['frames']} frames were lost; the previous ones are shown"]
    return []


def _record(clip: PreparedClip, corruption: str, parameter: int, stream: Stream, changed: int) -> dict[str, Any]:
    damage = stream.damage
    record: dict[str, Any] = {
        "clip": clip.name,
        "corruption": corruption,
        "parameter": parameter,
        "master_sha256": clip.manifest.master_sha256,
        "encoder": encoder_versions(),
        "frames": stream.fill.count,
        "bytes_coded": stream.bytes_coded,
        "packets_refused": stream.decoder.refused_packets,
        "pictures_dropped": stream.fill.dropped + stream.decoder.strange_pictures,
        "frames_lost": stream.fill.frames_lost,
        "lost": [list(run) for run in stream.fill.lost],
        "key_frames": len(clip.manifest.key_frames),
        "key_frames_changed": changed,
    }
    if damage:
        record |= {
            "bytes_changed": damage.bytes_changed,
            "frames_hit": len(damage.frames_hit),
            "hit": sorted(damage.frames_hit),
        }
    return record | {"warnings": warnings_of(record)}


DEFAULT_RATE = Fraction(30)
"""Default frame rate for folders of images, in frames per second."""


def frame_rate(path: Path) -> Fraction:
    if path.is_dir():
        return DEFAULT_RATE
    with open_video(path) as container:
        stream = main_stream(container, path)
        return Fraction(stream.average_rate or stream.guessed_rate or DEFAULT_RATE)


class ShortClip:
    """A part of a clip, losslessly encoded once, like the benchmark's master, in constant memory."""

    def __init__(self, frames: Iterable[Frame], rate: Fraction, folder: Path) -> None:
        rest = iter(frames)
        first = next(rest, None)
        if first is None:
            raise DataError("clip", "it needs at least one frame")
        size = first.shape[:2]

        def pictures() -> Iterable[np.ndarray]:
            yield rgb_to_i420(first)
            for number, frame in enumerate(rest, 1):
                if frame.shape[:2] != size:
                    raise DataError(f"frame {number}", "differs in size from the first frame of the clip")
                yield rgb_to_i420(frame)

        self._master = write_clip(folder / "master.mp4", pictures(), size, rate, lossless("veryfast"))

    def corrupted(self, corruption: str, parameter: int, wanted: range) -> tuple[list[Frame], bool]:
        master = self._master
        stream = corrupted_stream(master, corruption, parameter)
        frames = []
        for index, picture in stream.pictures:
            if index in wanted:
                frames.append(i420_to_rgb(picture, master.height, master.width))
            if index == wanted[-1]:
                break
        return frames, stream.damage is None or stream.damage.bytes_changed > 0

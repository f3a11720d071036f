"""Place decoded frames at their positions and fill the gaps. Corrupt a clip with H.264 CRF, H.264 ABR or Bit Error
(paper appendix, "Video corruptions").

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
from pathlib import Path
from typing import Any

from ...core.errors import DataError, UsageError
from ...core.files import make_folder
from ...media.images import read_image
from .clip import ClipFile, read_header, read_packets, read_pictures, write_clip
from .codec import I420, Decoder, Encoder, Packet, abr, crf, encoder_versions, i420_to_rgb, lossless
from .damage import Damage, damage_packets
from .prepared import PreparedClip

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
        """Return the number of replaced frames."""
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
        raise DataError(
            f"none of the {fill.count} frames could be decoded from the damaged stream; choose a lower severity"
        )
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
    height, width = master.stored_size
    fill = Fill(master.count)
    if corruption == "bit_error":
        damage = Damage(parameter)
        decoder = Decoder(read_header(master), height, width)
        packets = damage_packets(read_packets(master), damage)
        return Stream(fill_lost(decoder.decode(packets), fill), decoder, fill, damage)
    if corruption not in ("h264_crf", "h264_abr"):
        raise UsageError(f"'{corruption}' is not a video corruption: choose h264_crf, h264_abr or bit_error")
    encoding = crf(parameter) if corruption == "h264_crf" else abr(parameter)
    encoder = Encoder(height, width, master.fps, encoding)
    decoder = Decoder(encoder.header, height, width)
    stream = Stream(iter(()), decoder, fill)

    def counted() -> Iterator[Packet]:
        for packet in encoder.encode(read_pictures(master)):
            stream.bytes_coded += len(packet.data)
            yield packet

    stream.pictures = fill_lost(decoder.decode(counted()), fill)
    return stream


def make_variant(clip: PreparedClip, corruption: str, parameter: int, folder: Path) -> dict[str, Any]:
    """Write the variant's key frames to `folder` and return the record of how they were corrupted."""
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

    encoding = lossless("ultrafast", every_frame=True)
    write_clip(folder / FRAMES_FILE, key_pictures(), (master.height, master.width), master.fps, encoding)
    return _record(clip, corruption, parameter, stream, changed)


def warnings_of(record: dict[str, Any]) -> list[str]:
    """Return warnings about a variant, to be shown to users of its results."""
    where = f"{record['corruption']} (parameter {record['parameter']}) on {record['clip']}"
    if record["corruption"] == "bit_error" and not record["bytes_changed"]:
        return [
            f"{where}: none of {record['bytes_coded']} bytes was changed; the clip is too small for this severity, "
            "so its frames are unchanged"
        ]
    if record["frames_lost"]:
        return [
            f"{where}: {record['frames_lost']} of {record['frames']} frames were lost and replaced by the previous ones"
        ]
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
        "bytes_coded": damage.bytes_total if damage else stream.bytes_coded,
        "packets_refused": stream.decoder.log.refused_packets,
        "pictures_dropped": stream.fill.dropped + stream.decoder.log.strange_pictures,
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

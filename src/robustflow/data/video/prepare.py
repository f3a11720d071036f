"""Create the lossless master and key frames of a clip from its source; resumable and in constant memory.

A source is interpolated in segments, which are separate lossless files and survive an interruption. A single
encoder then writes the master from all segments, so interruptions do not affect the file, and the key frames are
written in the same pass. `clip.json` is written last.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path

from ...core.errors import DataError, UsageError
from ...core.files import digest_of_value, make_folder, quick_digest_of_file, sealed, sha256_of_file, write_json
from ...media.images import write_image
from .clip import ClipFile, read_pictures, write_clip
from .codec import I420, check_size, encoder_versions, even_size, i420_to_rgb, lossless, rgb_to_i420
from .interpolation import WINDOW, Interpolator, fill_gaps, interpolated_count, load_interpolator, windows
from .prepared import (
    CLIP_MANIFEST,
    KEY_FRAMES,
    MASTER,
    REACH,
    VERSION,
    ClipManifest,
    PreparedClip,
    choose_key_frames,
    locked,
    read_manifest,
)
from .source import Source

SEGMENT = 64
"""Number of gaps between source frames per segment; an interruption loses at most one segment of work."""

MOST_FACTOR = 100

PAIR_FPS = 30
"""Default number of pairs per second, as in the paper."""

Progress = Callable[[str, str, int, int], None]
"""Called with (clip, stage, frames done, total frames)."""


@dataclass(frozen=True)
class Preparation:
    fps: Fraction | None = None
    factor: int = 4
    step: int | None = None
    interpolator: str | None = None
    checkpoint: Path | None = None
    device: str = "cpu"
    preset: str = "veryslow"


@dataclass(frozen=True)
class ClipTiming:
    fps: Fraction
    count: int
    step: int
    key_frames: tuple[int, ...]


def clip_timing(source: Source, preparation: Preparation) -> ClipTiming:
    check_size(*source.size)
    rate = preparation.fps or source.fps
    if rate is None or rate <= 0:
        raise UsageError("--fps", f"{source.name} is a folder of images, which has no frame rate; give one")
    if not 1 <= preparation.factor <= MOST_FACTOR:
        raise UsageError("--factor", f"{preparation.factor} is not from 1 (no interpolation) to {MOST_FACTOR}")
    fps = rate * preparation.factor
    step = max(1, round(fps / PAIR_FPS)) if preparation.step is None else preparation.step
    if step < 1:
        raise UsageError("--step", f"{step} is invalid; give at least 1")
    count = interpolated_count(source.count, preparation.factor)
    keys = choose_key_frames(count, step)
    if len(keys) < 2:
        second = step * max(1, -(-REACH // step)) + step  # the first key frame is at least REACH frames from the start
        needed = second + max(step, REACH) + 1
        if preparation.factor > 1:
            needed = -(-(needed - 1) // preparation.factor) + WINDOW - 1
        smaller = ", or a smaller --step" if len(choose_key_frames(count, 1)) > 1 else ""
        what = f"{source.count} frames are too few for two key frames {step} apart, {REACH} or more from both ends"
        raise DataError(source.name, f"{what}; at least {needed} are needed: use a longer clip{smaller}")
    return ClipTiming(fps, count, step, tuple(keys))


def prepare_clip(
    source: Source, folder: Path, preparation: Preparation, progress: Progress = lambda clip, what, done, total: None
) -> PreparedClip:
    """Prepare one clip in `folder`; resume if an earlier call was interrupted, and wait if another process prepares
    it.
    """
    timing = clip_timing(source, preparation)
    p = preparation
    interpolator = load_interpolator(p.interpolator, p.factor, p.checkpoint, p.device)
    expected = ClipManifest(
        version=VERSION,
        name=source.name,
        count=timing.count,
        fps=str(timing.fps),
        height=source.size[0],
        width=source.size[1],
        factor=preparation.factor,
        step=timing.step,
        key_frames=list(timing.key_frames),
        padded_to_even=source.size != even_size(*source.size),
        preset=preparation.preset,
        source=source.describe() | {"frames": source.count},
        interpolator=interpolator.describe() if interpolator else None,
        encoder=encoder_versions(),
        master_sha256="",
    )
    make_folder(folder / KEY_FRAMES)
    with locked(folder.with_name(f".{folder.name}.lock")):
        return _finished(folder, expected) or _write_clip(source, folder, expected, interpolator, progress)


def _write_clip(
    source: Source, folder: Path, wanted: ClipManifest, interpolator: Interpolator | None, progress: Progress
) -> PreparedClip:
    work = folder / f".segments-{digest_of_value(wanted.model_dump())}"
    if interpolator is None:
        pictures: Iterable[I420] = map(rgb_to_i420, source.frames())
    else:
        pictures = _segments(source, work, wanted, interpolator, progress)
    written = _with_key_frames(pictures, folder, wanted, progress)
    size = (wanted.height, wanted.width)
    master = write_clip(folder / MASTER, written, size, Fraction(wanted.fps), lossless(wanted.preset))
    if master.count != wanted.count:
        raise DataError(source.name, f"gave {master.count} frames instead of {wanted.count}; check the file")
    manifest = wanted.model_copy(update={"master_sha256": sha256_of_file(folder / MASTER)})
    write_json(folder / CLIP_MANIFEST, sealed(manifest.model_dump()))
    for leftover in folder.glob(".segments-*"):
        shutil.rmtree(leftover, ignore_errors=True)
    return PreparedClip(folder, manifest)


def _finished(folder: Path, wanted: ClipManifest) -> PreparedClip | None:
    path = folder / CLIP_MANIFEST
    if not path.is_file():
        return None
    manifest = read_manifest(path, ClipManifest)
    same = {"master_sha256": "", "encoder": {}}
    if manifest.model_copy(update=same) != wanted.model_copy(update=same):
        raise DataError(folder, "contains this clip with different settings; choose a different --output or delete it")
    return PreparedClip(folder, manifest)


def _segments(
    source: Source, work: Path, wanted: ClipManifest, interpolator: Interpolator, progress: Progress
) -> Iterator[I420]:
    make_folder(work)
    gaps = source.count - WINDOW + 1
    size, factor, fps = (wanted.height, wanted.width), wanted.factor, Fraction(wanted.fps)
    parts: list[ClipFile] = []
    around = windows(source.frames())
    for start in range(0, gaps, SEGMENT):
        length = min(SEGMENT, gaps - start)
        path = next((path for path in work.glob(f"{start:06d}.*.mp4") if _is_intact(path)), None)
        if path is not None:
            deque(islice(around, length), maxlen=0)
        else:
            frames = fill_gaps(islice(around, length), interpolator, factor, first=start == 0)
            unnamed = work / f"{start:06d}.mp4"
            write_clip(unnamed, map(rgb_to_i420, frames), size, fps, lossless("ultrafast"))
            path = unnamed.rename(work / f"{start:06d}.{quick_digest_of_file(unnamed)}.mp4")
        parts.append(ClipFile(path, length * factor + (start == 0), fps, *size))
        progress(wanted.name, "interpolate", start + length, gaps)
    for _ in around:
        raise DataError(source.name, "the source has more frames than before; do not change it during preparation")
    for part in parts:
        for _, picture in read_pictures(part):
            yield picture


def _is_intact(segment: Path) -> bool:
    return segment.suffixes[0] == f".{quick_digest_of_file(segment)}"


def _with_key_frames(
    pictures: Iterable[I420], folder: Path, wanted: ClipManifest, progress: Progress
) -> Iterator[I420]:
    keys = set(wanted.key_frames)
    for index, picture in enumerate(pictures):
        if index in keys:
            write_image(folder / KEY_FRAMES / f"{index:06d}.png", i420_to_rgb(picture, wanted.height, wanted.width))
        yield picture
        progress(wanted.name, "encode", index + 1, wanted.count)

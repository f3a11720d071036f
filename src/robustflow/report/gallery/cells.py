"""Cells of a gallery: a frame of a pair, or consecutive frames of a clip, under each corruption and severity."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, takewhile
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ...core.errors import UsageError
from ...core.types import Frame, Sample
from ...corruptions import CLIP, IMAGE_PAIR, Corruption, corrupt_clip, load_corruption
from ...corruptions.condition import condition_of
from ...corruptions.registry import BETWEEN_FRAMES
from ...media.colours import depth_colours
from .ssim import Ssim


@dataclass(frozen=True)
class GalleryCell:
    """The frames under one corruption at one severity, none if it does not exist; `still` is the index of the first
    frame that the corruption changes."""

    name: str
    severity: int
    frames: Sequence[Frame] = ()
    caption: str = ""
    still: int = 0


def pair_cells(
    sample: Sample,
    severities: Sequence[int],
    corruptions: Sequence[str] | None = None,
    seed: int = 0,
    scale: str = "paper",
    classes: Mapping[str, type[Corruption]] = MappingProxyType({}),
) -> Iterator[GalleryCell]:
    """Yield the cells of a pair, one corruption after another; each shows the first frame that the corruption
    changes.
    """
    wanted = IMAGE_PAIR if corruptions is None else corruptions
    chosen = {one.name: one for one in (load_corruption(name, scale=scale, classes=classes) for name in wanted)}
    clean = sample.frames[:2]
    if sample.depth is not None:
        near, far = (float(bound) for bound in (sample.depth.maps[0].min(), sample.depth.maps[0].max()))
        shown = depth_colours(sample.depth.maps[0])
        for severity in severities:
            yield GalleryCell("depth", severity, [shown], f"{near:.3g} m (white) to {far:.3g} m")

    def corrupted(name: str, severity: int) -> tuple[list[Frame], str]:
        frames: list[Frame] = []
        for frame in corrupt_clip(clean, chosen[name], severity, seed, sample.key, depth=sample.depth):
            frames.append(frame)
            if not np.array_equal(frame, clean[len(frames) - 1]):
                break  # the second frame is only needed if the first one is unchanged
        return frames, ""

    for cell in _cells(clean, list(chosen), severities, scale, corrupted):
        yield GalleryCell(cell.name, cell.severity, cell.frames[cell.still : cell.still + 1], cell.caption)


def _cells(
    clean: Sequence[Frame],
    corruptions: Sequence[str],
    severities: Sequence[int],
    scale: str,
    corrupted: Callable[[str, int], tuple[list[Frame], str]],
) -> Iterator[GalleryCell]:
    """Yield the cells, one corruption after another; `corrupted(name, severity)` makes the frames and a remark. The
    caption has the SSIM of the first frame that differs from its clean frame, because some corruptions change only
    some of them."""
    similarity = cache(lambda index: Ssim(clean[index]))
    for name in corruptions:
        levels = condition_of(name).levels(severities, scale)
        for severity in severities:
            if severity not in levels:
                yield GalleryCell(name, severity)
                continue
            frames, remark = corrupted(name, severity)
            changed = (index for index, frame in enumerate(frames) if not np.array_equal(frame, clean[index]))
            still = next(changed, 0)
            of_frame = f"frame {still + 1}" if still else ""
            ssim = f"SSIM {similarity(still)(frames[still]):.2f}"
            yield GalleryCell(name, severity, frames, ", ".join(filter(None, (ssim, of_frame, remark))), still)


LONGEST_PART = 96
"""Maximum number of encoded frames; the effect of H.264 and bit errors on a frame depends on earlier frames."""

SHOWN = 10
MOST_SHOWN = 24

MADE_FROM_CLIP = tuple(name for name in CLIP if name not in BETWEEN_FRAMES)
"""Corruptions that need a clip but no interpolated frames."""

_NEEDS_MORE = (
    f"{' and '.join(BETWEEN_FRAMES)} are left out: they need intermediate frames, which a clip has only after "
    "temporal interpolation (robustflow prepare gopro-fc)"
)


class ClipPart:
    """A part of a video or of a folder of frames, with the frames to show: the first frames of the part if `start` is
    given, otherwise frames from the middle of the clip.
    """

    def __init__(self, path: Path, start: str | None = None, stop: str | None = None, shown: int = SHOWN) -> None:
        if not 2 <= shown <= MOST_SHOWN:
            raise UsageError("--length", f"{shown} frames cannot be shown: choose 2 to {MOST_SHOWN}")
        from ...data.datasets.folder import open_folder
        from ...data.datasets.own_frames import continuous
        from ...data.video.variants import frame_rate  # imports PyAV, which the page of a run does not need

        self._data = open_folder(path, 1, start, stop)
        self.rate = frame_rate(path)
        keys = self._data.keys()
        part = continuous(self._data, keys[: LONGEST_PART - 1])
        joined = (second == first for (_, second), (first, _) in pairwise(map(self._data.frame_names, part)))
        self._keys = [part[0], *(key for key, _ in takewhile(itemgetter(1), zip(part[1:], joined, strict=True)))]
        self.count = len(self._keys) + 1
        begin = max(0, (self.count - shown) // 2) if start is None else 0
        self.shown = range(begin, min(begin + shown, self.count))
        digits = keys[0].isdigit() and path.is_file()
        self.first_number = (int(keys[0]) if digits else 0) + self.shown[0]

    def frames(self, numbers: range | None = None) -> Iterator[Frame]:
        """Yield the RGB frames, uint8 (H, W, 3), of the entire part or of a range of it."""
        for number in range(self.count) if numbers is None else numbers:
            if number < len(self._keys):
                yield self._data.load(self._keys[number]).frames[0]
            else:
                yield self._data.load(self._keys[-1]).frames[1]


def chosen_corruptions(names: Sequence[str] | None, scale: str) -> tuple[list[str], list[str]]:
    """Return the corruptions of a clip gallery, and sentences about omitted ones."""
    if names is not None:
        for name in names:
            parts = (condition := condition_of(name)).names
            if condition.needs_depth:
                raise UsageError(name, "needs depth, which is not available for clips; show a pair with --frames")
            if set(parts) & set(BETWEEN_FRAMES):
                raise UsageError(name, _NEEDS_MORE)
            if len(parts) > 1 and set(parts) & set(CLIP):
                raise UsageError(name, "corruptions of entire clips cannot be stacked in the gallery")
            if scale != "paper" and set(parts) & set(CLIP):
                raise UsageError(name, f"no {scale} severities; omit --severity-scale")
        return list(names), []
    if scale != "paper":
        return list(IMAGE_PAIR), [f"{', '.join(CLIP)} are left out: they do not have {scale} severities."]
    return [*IMAGE_PAIR, *MADE_FROM_CLIP], [f"{_NEEDS_MORE}."]


def clip_cells(
    part: ClipPart,
    shown: Sequence[Frame],
    severities: Sequence[int],
    corruptions: Sequence[str],
    folder: Path,
    seed: int = 0,
    key: str = "",
    scale: str = "paper",
) -> Iterator[GalleryCell]:
    """Yield the cells, one corruption after another. Only the shown frames and the frames of one cell are kept in
    memory; the clip is encoded into `folder` if a corruption needs it.
    """
    from ...data.video.variants import ShortClip

    encoded = cache(lambda: ShortClip(part.frames(), part.rate, folder))

    def corrupted(name: str, severity: int) -> tuple[list[Frame], str]:
        if name not in MADE_FROM_CLIP:
            return list(corrupt_clip(shown, name, severity, seed, key, scale=scale)), ""
        frames, changed = encoded().corrupted(name, load_corruption(name).parameter(severity), part.shown)
        return frames, "" if changed else "no bit errors"

    yield from _cells(shown, corruptions, severities, scale, corrupted)

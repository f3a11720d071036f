"""The gallery of a clip: the same few frames under each corruption, so that its course over time is visible."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ...corruptions import CLIP, IMAGE_PAIR, corrupt_clip, load_corruption
from ...corruptions.calibration.ssim import Ssim
from ...corruptions.registry import BETWEEN_FRAMES
from ...corruptions.stack import levels_of, needs_depth, split_stack
from ...datasets.folder import open_folder
from ...errors import UsageError
from ...sample import Frame
from ...video.short_clip import ShortClip, frame_rate

if TYPE_CHECKING:
    from ...datasets.folder import FrameFolder
    from ...datasets.video import Video

LONGEST_PART = 96
"""Number of frames that are encoded, because the effect of H.264 and bit errors depends on earlier frames."""

SHOWN = 10
MOST_SHOWN = 24

MADE_FROM_CLIP = tuple(name for name in CLIP if name not in BETWEEN_FRAMES)
"""The corruptions that need a clip and can be made from any."""

_NEEDS_MORE = (
    f"{' and '.join(BETWEEN_FRAMES)} are left out: they take frames between the frames, which a clip only has after "
    "interpolation in time (robustflow prepare gopro-fc)"
)


@dataclass(frozen=True)
class ClipCell:
    """The frames under one corruption at one severity; none if the severity does not exist on the scale."""

    name: str
    severity: int
    frames: Sequence[Frame] = field(default_factory=list)
    caption: str = ""
    ssim: float = 1.0


class ClipPart:
    """A part of a video, or of a folder of frames, and the frames that are shown: those at `start`, or in its middle.

    Args:
        path: a video file, or a folder of pictures (of a folder of such folders, the first).
        start, stop: frame numbers, or for a video times such as "12.5s"; `stop` is exclusive.
        shown: how many frames, 2 to `MOST_SHOWN`; fewer if the part has fewer.

    Raises:
        DataError: not a clip, or fewer than two frames in the part.
        UsageError: a number of frames that a page cannot hold.
    """

    def __init__(self, path: Path, start: str | None = None, stop: str | None = None, shown: int = SHOWN) -> None:
        if not 2 <= shown <= MOST_SHOWN:
            raise UsageError(f"{shown} frames cannot be shown: choose 2 to {MOST_SHOWN}")
        self._data: FrameFolder | Video = open_folder(path, 1, start, stop)
        self.rate = frame_rate(path)
        keys = self._data.keys()
        group = self._data.load(keys[0]).group
        self._keys = [key for key in keys[: LONGEST_PART - 1] if self._data.load(key).group == group]
        self.count = len(self._keys) + 1
        begin = max(0, (self.count - shown) // 2) if start is None else 0
        self.shown = range(begin, min(begin + shown, self.count))
        digits = keys[0].isdigit() and path.is_file()
        self.first_number = (int(keys[0]) if digits else 0) + self.shown[0]

    def frames(self, numbers: range | None = None) -> Iterator[Frame]:
        """RGB uint8 (H, W, 3) of the whole part, or of some of its frames, one at a time."""
        for number in range(self.count) if numbers is None else numbers:
            if number < len(self._keys):
                yield self._data.load(self._keys[number]).frames[0]
            else:
                yield self._data.load(self._keys[-1]).frames[1]


def chosen_corruptions(names: Sequence[str] | None, scale: str) -> tuple[list[str], list[str]]:
    """The corruptions in the gallery of a clip, and sentences about those left out.

    Raises:
        UsageError: a corruption was requested by name that cannot be made from a plain clip.

    >>> chosen, left_out = chosen_corruptions(None, "paper")
    >>> len(chosen), [sentence.partition(":")[0] for sentence in left_out]
    (23, ['object_motion_blur and rolling_shutter are left out'])
    """
    if names is not None:
        for name in names:
            parts = [part for part, _ in split_stack(name)]
            if needs_depth(name):
                raise UsageError(
                    f"{name} needs depth, which the frames of a clip do not have; show a pair with --frames"
                )
            if set(parts) & set(BETWEEN_FRAMES):
                raise UsageError(_NEEDS_MORE)
            if len(parts) > 1 and set(parts) & set(CLIP):
                raise UsageError(f"'{name}' cannot be shown: a corruption of the whole clip does not stack here")
            if scale != "paper" and set(parts) & set(CLIP):
                raise UsageError(f"{name} has no {scale} severities; leave out --severity-scale")
        return list(names), []
    if scale != "paper":
        return list(IMAGE_PAIR), [f"{', '.join(CLIP)} are left out: they have no {scale} severities."]
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
) -> Iterator[ClipCell]:
    """The cells, corruption by corruption; holds the frames shown, and those of one cell.

    Args:
        part: the clip.
        shown: its frames `part.shown`.
        severities: of 1 to 5.
        corruptions: from `chosen_corruptions`.
        folder: an empty one for the encoded clip.
        seed, key: of the draws; the frames equal those of `corrupt_clip`.
        scale: "paper" or "calibrated".
    """
    similarity = Ssim(shown[0])
    encoded: ShortClip | None = None
    for name in corruptions:
        for severity in severities:
            if severity not in levels_of(name, tuple(severities), scale):
                yield ClipCell(name, severity)
                continue
            remark = ""
            if name in MADE_FROM_CLIP:
                encoded = encoded or ShortClip(part.frames(), part.rate, folder)
                parameter = load_corruption(name).parameter(severity)
                frames, changed = encoded.corrupted(name, parameter, part.shown)
                remark = "" if changed else ", no byte hit"
            else:
                frames = list(corrupt_clip(shown, name, severity, seed, key, scale=scale))
            ssim = similarity(frames[0])
            yield ClipCell(name, severity, frames, f"SSIM {ssim:.2f}{remark}", ssim)

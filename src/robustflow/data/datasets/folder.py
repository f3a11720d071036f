"""Your own frames, without ground truth: a folder of images, a folder of such folders, or a video.

Consecutive images in natural order ("frame2" before "frame10") form pairs. The images directly in the folder are used;
its subfolders are used only if there are none.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path

from ...core.arguments import check_count
from ...core.errors import DataError, UsageError
from ...core.paths import VIDEO_SUFFIXES, folders, user_path
from ...core.types import Frame, Sample
from ...media.images import IMAGE_SUFFIXES, image_size, images_in, natural_order
from ..video.reader import VideoReader
from .base import OWN_FRAMES, DatasetFacts, described
from .pairs import PairDataset, PairFiles, Position, Samples, pairs_at_step, position, too_few_frames

FACTS = DatasetFacts(
    title="Your own frames",
    description="Consecutive frames from a folder, from its subfolders, or from a video.",
    ground_truth="none",
    clips="always",
    licence="yours",
    citation="none",
    layout="images, folders of images, or a video file",
)

ALONE = "frames"
"""Group of the images directly in the folder, independent of the folder's name."""


class FrameFolder(PairDataset):
    """Pairs from a folder of frames, or from every folder of frames inside a folder."""

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(self, root: Path, step: int = 1, start: Position = None, stop: Position = None) -> None:
        check_count("step", step)
        begin, end = _frame_number("start", start), _frame_number("stop", stop)
        images = images_in(root)
        sequences = {"": images} if images else {f.name: images_in(f) for f in folders(root)}
        pairs: dict[str, PairFiles] = {}
        for group, every in sequences.items():
            frames = every[begin:end]
            if not every:
                continue
            at_step = pairs_at_step(frames, step, root / group, len(every))
            _check(root / group, frames)
            for first, second in at_step:
                # Consecutive pairs are not independent; statistics treat them as one group.
                key, sequence = (f"{group}/{first.stem}", group) if group else (first.stem, ALONE)
                pairs[key] = PairFiles((first, second), group=sequence)
        if not pairs:
            kinds = ", ".join(IMAGE_SUFFIXES)
            raise DataError(root, f"contains no images ({kinds}); give a folder of frames or a video file")
        super().__init__(pairs, root)
        order = sorted(pairs, key=lambda key: natural_order(pairs[key].frames[0].relative_to(root).as_posix()))
        self._pairs = {key: pairs[key] for key in order}


class Video(Samples):
    """Pairs of video frames `step` apart, decoded on demand in constant memory. Keys are frame numbers from "000000".
    All pairs form one group, because frames of a video are not independent. Implements `Dataset` and `Clips`.
    """

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(self, path: Path, step: int = 1, start: Position = None, stop: Position = None) -> None:
        check_count("step", step)
        self._path, self._step = path, step
        self._readers = {0: VideoReader(path)}  # by offset: each decodes forward
        total = len(self._readers[0])
        begin, end = self._frame_number("start", start, 0), self._frame_number("stop", stop, total)
        self._end = min(end, total)
        if self._end - begin <= step:
            raise too_few_frames(max(0, self._end - begin), step, path, total)
        self._begin = begin
        self._keys = [f"{index:06d}" for index in range(begin, self._end - step)]

    def keys(self) -> list[str]:
        return list(self._keys)

    def files(self, key: str) -> list[Path]:
        self._index(key)
        return [self._path]

    def load(self, key: str) -> Sample:
        return Sample(key, (self.frame(key, 0), self.frame(key, 1)), group=self._path.stem)

    def around(self, key: str, reach: int) -> range:
        index = self._index(key)
        last = (self._end - 1 - index) // self._step
        return range(-min(reach, (index - self._begin) // self._step), min(reach + 1, last) + 1)

    def frame(self, key: str, offset: int) -> Frame:
        if offset not in self._readers:
            self._readers[offset] = copy(self._readers[0])  # a copy reopens the file
        return self._readers[offset].frame(self._index(key) + offset * self._step)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.files(key)

    def frame_names(self, key: str) -> tuple[int, int]:
        index = self._index(key)
        return index, index + self._step

    def _index(self, key: str) -> int:
        number = int(key) - self._begin if key.isascii() and key.isdigit() and len(key) < 12 else -1
        if not 0 <= number < len(self._keys) or self._keys[number] != key:
            raise UsageError(key, f"no such sample; keys go from '{self._keys[0]}' to '{self._keys[-1]}'")
        return int(key)

    def _frame_number(self, option: str, value: Position, default: int) -> int:
        chosen = position(option, value)
        if chosen is None:
            return default
        return self._readers[0].index_at(chosen) if isinstance(chosen, float) else chosen


@described(FACTS)
def open_folder(root: str | Path, step: int = 1, start: Position = None, stop: Position = None) -> FrameFolder | Video:
    """Open the dataset `folder`: a video file, a folder of frames, or a folder of such folders, optionally restricted
    to the range from `start` to `stop` (frame numbers, or for a video also times such as "12.5s" and "1:05").
    """
    path = user_path(root)
    if path.is_file():
        return Video(path, step, start, stop)
    if not path.is_dir():
        raise DataError(path, "no such folder or video; check the path")
    frames = images_in(path) or any(images_in(inner) for inner in folders(path))
    videos = [inner for inner in sorted(path.iterdir()) if inner.suffix.lower() in VIDEO_SUFFIXES]
    if videos and not frames:
        raise DataError(path, f"contains videos, not frames; give one file, for example {videos[0]}")
    return FrameFolder(path, step, start, stop)


def _frame_number(option: str, value: Position) -> int | None:
    chosen = position(option, value)
    if isinstance(chosen, float):
        raise UsageError(option, f"images have no timestamps, so {value} is none; give a frame number, counted from 0")
    return chosen


def _check(folder: Path, frames: list[Path]) -> None:
    stems: dict[str, Path] = {}
    size = image_size(frames[0])
    for frame in frames:
        if frame.stem in stems:
            raise DataError(folder, f"{stems[frame.stem].name} and {frame.name} share a name; remove one of them")
        stems[frame.stem] = frame
        if image_size(frame) != size:
            (h, w), (other_h, other_w) = size, image_size(frame)
            raise DataError(frame, f"{other_h}x{other_w}, but {frames[0]} is {h}x{w}; use separate folders, or resize")

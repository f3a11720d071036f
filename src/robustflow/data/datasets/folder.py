"""Your own frames, without ground truth: a folder of images, a folder of such folders, or a video.

Consecutive images in natural order ("frame2" before "frame10") form pairs, unless their names or contents show
independent pairs (`arrangement`). The images directly in the folder are used; its subfolders are used only if there are
none.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from copy import copy
from pathlib import Path

from ...core.arguments import check_count
from ...core.errors import DataError, UsageError
from ...core.paths import VIDEO_SUFFIXES, folders, user_path
from ...core.types import Frame, Sample
from ...media.images import IMAGE_SUFFIXES, image_size, images_in, natural_order, read_image
from ..video.reader import VideoReader
from .arrangement import CONSECUTIVE, arranged
from .base import OWN_FRAMES, DatasetFacts, described
from .continuity import OwnFrames
from .frame_names import irregular, without_maps
from .pairs import PairDataset, PairFiles, Position, pairs_at_step, position, too_few_frames

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


class FrameFolder(PairDataset, OwnFrames):
    """Pairs from a folder of frames, or from every folder of frames inside a folder."""

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(
        self,
        root: Path,
        step: int = 1,
        start: Position = None,
        stop: Position = None,
        pairs: str = "",
        gaps: str = "skip",
    ) -> None:
        check_count("step", step)
        begin, end = _frame_number("start", start), _frame_number("stop", stop)
        OwnFrames.__init__(self, root, gaps, read_image)
        images = images_in(root)
        inner = sorted(folders(root), key=lambda folder: natural_order(folder.name))
        places = {"": images} if images else {f.name: every for f in inner if (every := images_in(f))}
        if not places:
            kinds = ", ".join(IMAGE_SUFFIXES)
            raise DataError(root, f"contains no images ({kinds}); give a folder of frames or a video file")
        if pairs != CONSECUTIVE:
            places, maps = without_maps(places)
            self.notices += [f"{', '.join(maps)} not read as frames"] * bool(maps)
        chosen = {frame for every in places.values() for frame in every[begin:end]}
        films = arranged(places, pairs)
        self.independent = films.independent
        if films.recognised:
            self.recognised = {"pairs": films.recognised}
            self.notices += [films.notice] * (not pairs)
        if films.independent and step > 1:
            raise UsageError("step", f"{step}, but these are independent pairs; pairs={CONSECUTIVE} reads a film")
        found: dict[str, PairFiles] = {}
        several = len(films.films) > len(places)
        for group, film in ((group, film.within(chosen)) for group, film in films.films):
            frames = list(film.frames)
            if several and len(frames) < 2:
                continue
            of_film = pairs_at_step(frames, step, root / group, len(places.get(group, frames)))
            _check(root / group, frames)
            off = film.gaps() if gaps == "skip" else set()
            first_of_film = f"{group or ALONE}/{frames[0].stem}" if several else group or ALONE
            for place, pair in enumerate(of_film):
                # Consecutive pairs are not independent; statistics treat them as one group.
                key = f"{group}/{pair[0].stem}" if group else pair[0].stem
                if off.isdisjoint(range(place, place + step)):
                    found[key] = PairFiles(pair, group="" if films.independent else first_of_film)
                else:
                    self.irregular.append(key)
        PairDataset.__init__(self, found, root)
        self._pairs = found

    def keep(self, keys: Sequence[str]) -> None:
        self._pairs = {key: self._pairs[key] for key in keys}


class Video(OwnFrames):
    """Pairs of video frames `step` apart, decoded on demand in constant memory. Keys are frame numbers from "000000".
    All pairs form one group, because frames of a video are not independent. Implements `Dataset` and `Clips`.
    """

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(
        self,
        path: Path,
        step: int = 1,
        start: Position = None,
        stop: Position = None,
        pairs: str = "",
        gaps: str = "skip",
    ) -> None:
        check_count("step", step)
        if pairs not in ("", CONSECUTIVE):
            raise UsageError("pairs", f"'{pairs}' is for images; a video is a film")
        self._path, self._step, reader = path, step, VideoReader(path)
        super().__init__(path, gaps, reader.frame)
        self._readers = {0: reader}  # by offset: each decodes forward
        total = len(reader)
        begin, end = self._frame_number("start", start, 0), self._frame_number("stop", stop, total)
        self._end = min(end, total)
        if self._end - begin <= step:
            raise too_few_frames(max(0, self._end - begin), step, path, total)
        self._begin = begin
        timed = gaps == "skip" and len(set(reader.times)) == total
        off = irregular(reader.times) if timed else set[int]()
        self._breaks = sorted(off)
        regular = {f"{at:06d}": off.isdisjoint(range(at, at + step)) for at in range(begin, self._end - step)}
        self._keys, self.irregular = ([key for key in regular if regular[key] is kept] for kept in (True, False))

    def keys(self) -> list[str]:
        return list(self._keys)

    def files(self, key: str) -> list[Path]:
        self._index(key)
        return [self._path]

    def load(self, key: str) -> Sample:
        return Sample(key, (self.frame(key, 0), self.frame(key, 1)), group=self._path.stem)

    def around(self, key: str, reach: int) -> range:
        index = self._index(key)
        place = bisect_left(self._breaks, index)  # no window reaches across a gap
        begin = self._breaks[place - 1] + 1 if place else self._begin
        end = self._breaks[place] + 1 if place < len(self._breaks) else self._end
        last = (min(end, self._end) - 1 - index) // self._step
        return range(-min(reach, (index - max(begin, self._begin)) // self._step), min(reach + 1, last) + 1)

    def frame(self, key: str, offset: int) -> Frame:
        if offset not in self._readers:
            self._readers[offset] = copy(self._readers[0])  # a copy reopens the file
        return self._readers[offset].frame(self._index(key) + offset * self._step)

    def keep(self, keys: Sequence[str]) -> None:
        self._keys = list(keys)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.files(key)

    def frame_names(self, key: str) -> tuple[int, int]:
        index = self._index(key)
        return index, index + self._step

    def _index(self, key: str) -> int:
        place = bisect_left(self._keys, key)
        if place == len(self._keys) or self._keys[place] != key:
            raise UsageError(key, f"no such sample; keys go from '{self._keys[0]}' to '{self._keys[-1]}'")
        return int(key)

    def _frame_number(self, option: str, value: Position, default: int) -> int:
        chosen = position(option, value)
        if chosen is None:
            return default
        return self._readers[0].index_at(chosen) if isinstance(chosen, float) else chosen


@described(FACTS)
def open_folder(
    root: str | Path, step: int = 1, start: Position = None, stop: Position = None, pairs: str = "", gaps: str = "skip"
) -> FrameFolder | Video:
    """Open the dataset `folder`: a video file, a folder of frames, or a folder of such folders, optionally restricted
    to the range from `start` to `stop` (frame numbers, or for a video also times such as "12.5s" and "1:05").

    Args:
        pairs: "consecutive" for films, "disjoint" for frames 1 and 2, 3 and 4, ..., "names" for pairs by the frames'
            names; by default films, unless names or frames tell otherwise.
        gaps: "keep" to keep pairs whose frames are not consecutive: in numbers or times, repeated, or across a cut.
    """
    path = user_path(root)
    if path.is_file():
        return Video(path, step, start, stop, pairs, gaps)
    if not path.is_dir():
        raise DataError(path, "no such folder or video; check the path")
    frames = images_in(path) or any(images_in(inner) for inner in folders(path))
    videos = [inner for inner in sorted(path.iterdir()) if inner.suffix.lower() in VIDEO_SUFFIXES]
    if videos and not frames:
        raise DataError(path, f"contains videos, not frames; give one file, for example {videos[0]}")
    return FrameFolder(path, step, start, stop, pairs, gaps)


def _frame_number(option: str, value: Position) -> int | None:
    chosen = position(option, value)
    if isinstance(chosen, float):
        raise UsageError(option, f"images have no timestamps, so {value} is none; give a frame number, counted from 0")
    return chosen


def _check(folder: Path, frames: list[Path]) -> None:
    stems: dict[str, Path] = {}
    size = image_size(frames[0])
    for frame in frames:
        if frame.stem in stems and stems[frame.stem].parent == frame.parent:
            raise DataError(folder, f"{stems[frame.stem].name} and {frame.name} share a name; remove one of them")
        stems[frame.stem] = frame
        if image_size(frame) != size:
            (h, w), (other_h, other_w) = size, image_size(frame)
            raise DataError(frame, f"{other_h}x{other_w}, but {frames[0]} is {h}x{w}; use separate folders, or resize")

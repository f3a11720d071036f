"""Your own frames, without ground truth: a folder of images, a folder of such folders, or a video.

Consecutive images in natural order ("frame2" before "frame10") form pairs, unless their names or contents show
independent pairs (`arrangement`). The images directly in the folder are used; its subfolders are used only if there are
none. Pairs of frames that are not consecutive are left out (`continuity`).
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ...core.arguments import check_count, choice
from ...core.errors import DataError, UsageError
from ...core.paths import VIDEO_SUFFIXES, folders, user_path
from ...core.text import counted
from ...core.types import Frame
from ...media.images import IMAGE_SUFFIXES, image_size, images_in, natural_order, read_image
from .arrangement import CONSECUTIVE, Arrangement, arranged
from .base import OWN_FRAMES, Dataset, DatasetFacts, described
from .continuity import UNLIKE, faults
from .frame_names import without_maps
from .pairs import PairDataset, PairFiles, Position, position, too_few_frames

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

GAPS = ("skip", "keep")
_IRREGULAR = "a gap or change of the frame interval"


class OwnFrames(PairDataset):
    """Pairs of frames `step` apart from a user's films. The pairs of a film form one group, because statistics may not
    treat them as independent.

    Args:
        where: the folder or video.
        arrangement: the films.
        chosen: the frames to use.
        step: distance of the frames of a pair.
        gaps: "skip", or "keep" to keep pairs of frames that are not consecutive.

    Attributes:
        recognised: options that were chosen by what was recognised, for the identity of runs.
        notices: what was recognised or left out when the dataset was opened, as parts of one sentence.
    """

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(self, where: Path, arrangement: Arrangement, chosen: Collection[Any], step: int, gaps: str) -> None:
        self.where, self.independent, self._skips = where, arrangement.independent, gaps == "skip"
        self.recognised = {"pairs": arrangement.recognised} if arrangement.recognised else {}
        self.notices: list[str] = []
        self._irregular: list[str] = []
        self._faults: dict[str, str] = {}
        pairs: dict[str, PairFiles] = {}
        several = len(arrangement.films) > len({folder for folder, _ in arrangement.films})
        for folder, film in arrangement.films:
            count = sum(frame in chosen for frame in film.frames)
            if several and count < 2:
                continue
            if count <= step:
                raise too_few_frames(count, step, where / folder, len(film.frames))
            off = film.gaps() if self._skips else set()
            group = "" if self.independent else self._group(folder, film.frames[0] if several else None)
            for place, frames in enumerate(zip(film.frames, film.frames[step:], strict=False)):
                if not (frames[0] in chosen and frames[1] in chosen):
                    continue
                key = self._key(folder, frames[0])
                if off.isdisjoint(range(place, place + step)):
                    pairs[key] = PairFiles(frames, group=group)
                else:
                    self._irregular.append(key)
        super().__init__(pairs, where)
        self._pairs = pairs  # in the order of the frames

    def read(self, frame: Any) -> Frame:
        """Return a frame by its name."""
        return read_image(frame)

    def keep(self, keys: Sequence[str]) -> None:
        """Leave out all other pairs."""
        self._pairs = {key: self._pairs[key] for key in keys}

    def consecutive(self, keys: Sequence[str], compare: bool) -> list[str]:
        """See `continuous`."""
        unknown = [key for key in keys if key not in self._faults] if compare and self._skips else []
        self._faults |= faults({key: pair.frames for key, pair in self._pairs.items()}, unknown, self.read)
        reasons = {key: self._faults[key] for key in keys if self._faults.get(key)} if compare else {}
        by_reason: dict[str, list[str]] = {}
        for key, reason in (dict.fromkeys(self._irregular, _IRREGULAR) | reasons).items():
            by_reason.setdefault(reason, []).append(key)
        unlike = by_reason.pop(UNLIKE, [])
        notices = list(self.notices)
        if by_reason:
            counts = (f"{counted(len(out), 'pair')} across {reason} ({out[0]})" for reason, out in by_reason.items())
            notices.append(f"{', '.join(counts)} left out (-D gaps=keep keeps them)")
        if unlike and (self.independent or 2 * len(unlike) > len(keys)):  # the motion of a film can be too fast
            notices.append(f"the frames of {counted(len(unlike), 'pair')} share no content ({', '.join(unlike[:3])})")
        if notices:
            warnings.warn(f"{self.where}: {'; '.join(notices)}", stacklevel=4)
        kept = [key for key in keys if reasons.get(key, UNLIKE) == UNLIKE]
        if not kept:
            raise DataError(self.where, "no pair of consecutive frames; check the frames, or give -D gaps=keep")
        return kept

    def _key(self, folder: str, frame: Any) -> str:
        return f"{folder}/{frame.stem}" if folder else str(frame.stem)

    def _group(self, folder: str, first: Any) -> str:
        return f"{folder or ALONE}/{first.stem}" if first else folder or ALONE


def continuous(dataset: Dataset, keys: Sequence[str], compare: bool = True) -> list[str]:
    """Return the keys of the pairs of consecutive frames, and say in one line what was recognised and left out. Only
    pairs of a user's own frames are left out.

    Raises:
        DataError: no pair remains.
    """
    return dataset.consecutive(keys, compare) if isinstance(dataset, OwnFrames) else list(keys)


@described(FACTS)
def open_folder(
    root: str | Path, step: int = 1, start: Position = None, stop: Position = None, pairs: str = "", gaps: str = "skip"
) -> OwnFrames:
    """Open the dataset `folder`: a video file, a folder of frames, or a folder of such folders, optionally restricted
    to the range from `start` to `stop` (frame numbers, or for a video also times such as "12.5s" and "1:05").

    Args:
        pairs: "consecutive" for films, "disjoint" for frames 1 and 2, 3 and 4, ..., "names" for pairs by the frames'
            names; by default films, unless names or frames tell otherwise.
        gaps: "keep" to keep pairs whose frames are not consecutive: in numbers or times, repeated, or across a cut.
    """
    check_count("step", step)
    choice("gaps", gaps, GAPS)
    path = user_path(root)
    if path.is_file():
        from .own_video import OwnVideo  # imports PyAV

        if pairs not in ("", CONSECUTIVE):
            raise UsageError("pairs", f"'{pairs}' is for images; a video is a film")
        return OwnVideo(path, start, stop, step, gaps)
    if not path.is_dir():
        raise DataError(path, "no such folder or video; check the path")
    places = _images_by_folder(path)
    begin, end = _frame_number("start", start), _frame_number("stop", stop)
    maps: list[str] = []
    if pairs != CONSECUTIVE:
        places, maps = without_maps(places)
    chosen = {frame for frames in places.values() for frame in frames[begin:end]}
    arrangement = arranged(places, pairs)
    if arrangement.independent and step > 1:
        raise UsageError("step", f"{step}, but these are independent pairs; pairs={CONSECUTIVE} reads a film")
    for folder, film in arrangement.films:
        _check(path / folder, [frame for frame in film.frames if frame in chosen])
    dataset = OwnFrames(path, arrangement, chosen, step, gaps)
    dataset.notices += [f"{', '.join(maps)} not read as frames"] * bool(maps)
    dataset.notices += [arrangement.notice] * bool(arrangement.notice and not pairs)
    return dataset


def _images_by_folder(path: Path) -> dict[str, list[Path]]:
    """Return the images directly in a folder under the name "", or else those of its subfolders by name."""
    if images := images_in(path):
        return {"": images}
    inner = sorted(folders(path), key=lambda folder: natural_order(folder.name))
    if places := {folder.name: images for folder in inner if (images := images_in(folder))}:
        return places
    if videos := sorted(file for file in path.iterdir() if file.suffix.lower() in VIDEO_SUFFIXES):
        raise DataError(path, f"contains videos, not frames; give one file, for example {videos[0]}")
    raise DataError(path, f"contains no images ({', '.join(IMAGE_SUFFIXES)}); give a folder of frames or a video file")


def _frame_number(option: str, value: Position) -> int | None:
    chosen = position(option, value)
    if isinstance(chosen, float):
        raise UsageError(option, f"images have no timestamps, so {value} is none; give a frame number, counted from 0")
    return chosen


def _check(folder: Path, frames: list[Path]) -> None:
    """Raise unless the frames of a film have one size and different names."""
    stems: dict[Path, Path] = {}
    for frame in frames:
        same = stems.setdefault(frame.with_suffix(""), frame)
        if same != frame:
            raise DataError(folder, f"{same.name} and {frame.name} share a name; remove one of them")
        if (size := image_size(frame)) != (first := image_size(frames[0])):
            where = f"{size[0]}x{size[1]}, but {frames[0]} is {first[0]}x{first[1]}"
            raise DataError(frame, f"{where}; use separate folders, or resize")

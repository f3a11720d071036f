"""Open your own frames: a folder of images, a folder of such folders, or a video.

Consecutive images in natural order ("frame2" before "frame10") form pairs, unless their names or contents show
independent pairs (`arrangement`). The images directly in the folder are used; its subfolders are used only if there are
none.
"""

from __future__ import annotations

from pathlib import Path

from ...core.arguments import check_count, choice
from ...core.errors import DataError, UsageError
from ...core.paths import VIDEO_SUFFIXES, folders, user_path
from ...media.images import IMAGE_SUFFIXES, image_size, images_in, natural_order
from .arrangement import CONSECUTIVE, arranged
from .dataset import described
from .frame_names import without_maps
from .own_frames import FACTS, OwnFrames
from .pair_files import Position, position

GAPS = ("skip", "keep")


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

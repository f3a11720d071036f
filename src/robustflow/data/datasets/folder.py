"""Your own frames, without ground truth: a folder of images, a folder of such folders, or a video.

Consecutive images in natural order ("frame2" before "frame10") form pairs. The images directly in the folder are used;
its subfolders are used only if there are none.
"""

from __future__ import annotations

from pathlib import Path

from ...core.arguments import positive
from ...core.errors import DataError, UsageError
from ...core.paths import VIDEO_SUFFIXES, folders, user_path
from ...media.images import IMAGE_SUFFIXES, image_size, images_in, natural_order
from .base import DatasetFacts, described
from .clips import Video
from .pairs import PairDataset, PairFiles, Position, pairs_at_step, position

FACTS = DatasetFacts(
    title="Your own frames",
    description="Consecutive frames from a folder, from its subfolders, or from a video.",
    ground_truth="none",
    clips="always",
    licence="yours",
    citation="none",
    layout="images, folders of images, or a video file",
)

OWN_FRAMES = "folder"
"""Registered name of this dataset."""

ALONE = "frames"
"""Group of the images directly in the folder, independent of the folder's name."""


class FrameFolder(PairDataset):
    """Pairs from a folder of frames, or from every folder of frames inside a folder."""

    name = OWN_FRAMES
    has_flow = False
    facts = FACTS

    def __init__(self, root: Path, step: int = 1, start: Position = None, stop: Position = None) -> None:
        positive("step", step)
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


_MARKS = {
    "kitti2012": ("training/colored_0", "colored_0", "training/image_0", "image_0"),
    "kitti-fc": ("training/image_2", "image_2", "clean/val/image_2"),
    "sintel": ("training/clean", "training/final"),
    "hd1k": ("hd1k_input/image_2",),
    "spring": ("train/0001/frame_left",),
    "middlebury": ("other-gt-flow",),
    "flyingthings3d": ("frames_cleanpass", "frames_finalpass", "train/image_clean"),
    "gopro-fc": ("gopro_fc.json",),
}
"""For each benchmark, paths that exist only in its folder."""

_ALSO_READ_BY = {"kitti-fc": ("kitti2015", "kitti_multiview", "kitti_fc_released"), "gopro-fc": ("gopro_fc_prepared",)}
"""Datasets that read the folder of a benchmark, too."""


def different_benchmark(root: Path, name: str) -> str | None:
    """Return the benchmark whose layout matches a folder; None if `name` reads this layout, or if none matches."""
    fitting = benchmark_of_folder(root)
    return None if fitting is None or name in (fitting, *_ALSO_READ_BY.get(fitting, ())) else fitting


def benchmark_of_folder(root: Path) -> str | None:
    fitting = (name for name, marks in _MARKS.items() if any((root / mark).exists() for mark in marks))
    return next(fitting, None)

"""Guess the dataset in a folder, for the message when a folder does not match the requested dataset."""

from __future__ import annotations

from pathlib import Path

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
    """Return the benchmark whose layout matches a folder, or None.

    >>> from tempfile import mkdtemp
    >>> root = Path(mkdtemp())
    >>> (root / "training" / "colored_0").mkdir(parents=True)
    >>> benchmark_of_folder(root)
    'kitti2012'
    """
    fitting = (name for name, marks in _MARKS.items() if any((root / mark).exists() for mark in marks))
    return next(fitting, None)

"""Which data set a folder looks like, for the error that refuses it as another one."""

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
"""For each benchmark, what only its folder contains."""


def benchmark_of_folder(root: Path) -> str | None:
    """The benchmark that fits a folder by its layout; None if none does.

    >>> from tempfile import mkdtemp
    >>> root = Path(mkdtemp())
    >>> (root / "training" / "colored_0").mkdir(parents=True)
    >>> benchmark_of_folder(root)
    'kitti2012'
    """
    fitting = (name for name, marks in _MARKS.items() if any((root / mark).exists() for mark in marks))
    return next(fitting, None)

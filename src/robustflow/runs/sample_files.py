"""List the files from which a sample is read: those of the pair, of the frames around it, and of its depth."""

from __future__ import annotations

from pathlib import Path

from ..datasets.base import Clips, Dataset, Depths
from ..datasets.context_frames import ContextFrames
from ..models.window import Window
from ..target import called


def files_of_sample(dataset: Dataset, key: str, window: Window | None, depths: Depths | None) -> list[Path]:
    """Return the files from which a sample is read; files used only for depth come last.

    Args:
        dataset: dataset that contains the sample.
        key: key of the sample.
        window: window of frames that a multi-frame model receives; None for a two-frame model.
        depths: source of the depth; None if depth is not read.

    Raises:
        UsageError: a user's dataset raised an exception.
    """
    files: list[Path] = called(f"the dataset failed in files('{key}')", lambda: dataset.files(key))
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    of_depth = [] if depths is None else [path for path in depths.depth_files(key) if path not in files]
    return [*files, *of_depth]

"""List the files from which a sample is read: those of the pair, of the frames around it, and of its depth."""

from __future__ import annotations

from pathlib import Path

from ..datasets.base import Clips, Dataset, Depths
from ..datasets.context_frames import ContextFrames
from ..models.window import Window
from ..target import called


def files_of_sample(dataset: Dataset, key: str, window: Window | None, depths: Depths | None) -> list[Path]:
    """Return the files from which a sample is read; files used only for depth come last."""
    files: list[Path] = called(f"the dataset failed in files('{key}')", lambda: dataset.files(key))
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    of_depth = [] if depths is None else [path for path in depths.depth_files(key) if path not in files]
    return [*files, *of_depth]

"""Which files a sample is read from: its own, those of the frames around it, and those of its depth."""

from __future__ import annotations

from pathlib import Path

from ..datasets.base import Clips, Dataset, Depths
from ..datasets.context_frames import ContextFrames
from ..models.window import Window


def files_of_sample(dataset: Dataset, key: str, window: Window | None, depths: Depths | None) -> list[Path]:
    """The files that a sample is read from; those of its depth, and of nothing else, come last.

    Args:
        dataset: where the sample is.
        key: the sample.
        window: of a model that is given more frames than the pair.
        depths: where the depth comes from; None if it is not read.
    """
    files = dataset.files(key)
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    of_depth = [] if depths is None else [path for path in depths.depth_files(key) if path not in files]
    return [*files, *of_depth]

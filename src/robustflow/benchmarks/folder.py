"""`folder`: the user's own frames or video. No ground truth, so RCRE only."""

from __future__ import annotations

from pathlib import Path

from ..corruptions import IMAGE_PAIR
from ..datasets import load_dataset
from ..errors import UsageError
from .base import Benchmark


def folder(data: Path | None, split: Path | None) -> Benchmark:
    """Consecutive frames of a folder (or folder of folders, or video file), under every image-pair corruption."""
    if data is None:
        raise UsageError("the folder benchmark needs frames: give --data PATH (a folder of images or a video file)")
    if split is not None:
        raise UsageError("the folder benchmark has no split: leave out --split and choose the frames by the folder")
    dataset = load_dataset("folder", data)
    return Benchmark("folder", dataset, tuple(dataset.keys()), IMAGE_PAIR)

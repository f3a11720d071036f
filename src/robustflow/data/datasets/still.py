"""Still scenes: every frame of a dataset paired with itself, with a true flow of zero."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from ...core.errors import UsageError
from ...core.types import Camera, Frame, Sample, SceneDepth
from .dataset import Dataset, Depths, PreCorrupted, no_depth
from .pair_files import Samples

SECOND = ":2"
"""Suffix of the key of a still scene made from the second frame of a pair."""


@runtime_checkable
class SharesFrames(Protocol):
    """A dataset that reports which of its pairs share a frame."""

    def frame_names(self, key: str) -> tuple[Hashable, Hashable]:
        """Return the names of the two frames of a pair; a frame has the same name in every pair."""


class Still(Samples):
    """A dataset in which every frame of a given dataset occurs once, paired with itself; the first frame of a pair
    keeps the pair's key. The true flow is zero everywhere, regardless of the pairs' ground truth.
    """

    has_flow = True

    def __init__(self, dataset: Dataset, keys: Iterable[str], depths: Depths | None = None) -> None:
        if isinstance(dataset, PreCorrupted):
            raise UsageError("--still", f"the frames of '{dataset.name}' are corrupted already, or as clips")
        self.name = dataset.name
        self._dataset = dataset
        self._own_depths = depths
        frames = {key: _frame_names(dataset, key) for key in keys}
        begin = {first: key for key, (first, _) in reversed(frames.items())}
        end = {second: key for key, (_, second) in reversed(frames.items()) if second not in begin}
        chosen = {*begin.values(), *(key + SECOND for key in end.values())}
        self._keys = [frame for key in frames for frame in (key, key + SECOND) if frame in chosen]

    def keys(self) -> list[str]:
        return list(self._keys)

    def files(self, key: str) -> list[Path]:
        return self._dataset.files(pair_key(key))

    def load(self, key: str) -> Sample:
        number = int(key.endswith(SECOND))
        return replace(still_scene(self._dataset.load(pair_key(key)), number), key=key)

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`: the frame's depth for both frames; the camera is at rest."""
        pair = self._depths().depth(self._dataset.load(pair_key(sample.key)))
        which = int(sample.key.endswith(SECOND))
        fx, fy, cx, cy = pair.camera.intrinsics(which)
        camera = Camera((fx, fy), (cx, cy), np.eye(3), np.zeros(3))
        return SceneDepth((pair.maps[which],) * 2, (pair.measured[which],) * 2, camera)

    def depth_files(self, key: str) -> list[Path]:
        return self._depths().depth_files(pair_key(key))

    def _depths(self) -> Depths:
        if self._own_depths is not None:
            return self._own_depths
        if not isinstance(self._dataset, Depths):
            raise no_depth("this corruption", self.name)
        return self._dataset

    def around(self, key: str, reach: int) -> range:
        return range(-reach, reach + 2)

    def frame(self, key: str, offset: int) -> Frame:
        return self.load(key).frames[0]

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.files(key)


def still_scene(sample: Sample, number: int) -> Sample:
    """Return a frame of a pair, 0 or 1, paired with itself; the true flow is zero everywhere."""
    frame = sample.frames[number]
    zero = np.zeros((*sample.shape, 2), np.float32)
    return Sample(sample.key, (frame, frame), zero, np.ones(sample.shape, bool), group=sample.group)


def _frame_names(dataset: Dataset, key: str) -> tuple[Hashable, Hashable]:
    return dataset.frame_names(key) if isinstance(dataset, SharesFrames) else ((key, 1), (key, 2))


def pair_key(key: str) -> str:
    """Return the key of the pair that a still scene comes from: "000010" for "000010:2"."""
    return key.removesuffix(SECOND)

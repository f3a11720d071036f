"""Read and augment training pairs by position, and return them as arrays."""

from __future__ import annotations

import multiprocessing
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...core.errors import DataError, RobustFlowError, class_and_message
from ...core.rng import Rng
from ...core.types import Flow, Frame, Mask
from ...corruptions.transform import CorruptionTransform
from ...data.datasets.dataset import Dataset
from ...data.datasets.pair_files import PairDataset, read_frames
from ...run.stages import memory_errors_named
from ..augmentation.augment import (
    Augmentation,
    apply_augmentation,
    apply_look,
    augmented_truth,
    augmented_whole,
    draw_augmentation,
    draw_look,
)
from ..augmentation.geometry import without_border
from ..recipe import ArflowObjective, BrightflowObjective, Objective
from .parts import OpenPart, Order

_LONGEST = 1000.0
"""Limit of a flow component in pixels; dense ground truth at or above it is invalid (RAFT)."""
_ATTEMPTS = 20
"""Number of consecutive unreadable pairs after which training stops."""


class Whole(NamedTuple):
    """The uncropped frames of a pair."""

    frame1: npt.NDArray[np.float32]
    frame2: npt.NDArray[np.float32]
    corner: tuple[int, int]


class TrainingPair(NamedTuple):
    """A pair as network input."""

    frame1: npt.NDArray[np.float32]
    frame2: npt.NDArray[np.float32]
    flow: npt.NDArray[np.float32]
    valid: npt.NDArray[np.float32]
    name: str
    whole: Whole | None = None
    plain: Whole | None = None
    changed: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]] | None = None


@dataclass(frozen=True)
class TrainingPairs:
    """A mix of data as one sequence of augmented pairs."""

    parts: Sequence[OpenPart]
    order: Order
    crop: tuple[int, int]
    seed: int
    corruption: CorruptionTransform | None = None
    skip_bad: bool = False
    objective: Objective | None = None

    def __len__(self) -> int:
        """Return the number of places in an epoch."""
        return sum(len(part) for part in self.parts)

    def __getitem__(self, position: int) -> TrainingPair:
        """Return the pair at a position."""
        for attempt in range(_ATTEMPTS):
            part, key = self._part_of(self.order.place(position, attempt))
            name = f"{part.dataset.name} {key}"
            try:
                with memory_errors_named(name, "fewer --loaders, a smaller --batch-size or smaller frames"):
                    return self._augmented(position, part, key)
            except DataError as error:
                unreadable = error
            except RobustFlowError:
                raise
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt) and multiprocessing.parent_process() is None:
                    raise  # Ctrl-C, which other processes ignore: there, the code of a user raised it
                unreadable = DataError(f"reading or augmenting it raised {class_and_message(error)}")
                unreadable.__cause__ = error
            if not self.skip_bad:
                advice = "restore it, or use --skip-bad to replace unreadable pairs"
                raise DataError(name, f"{unreadable}; {advice}") from unreadable
            warnings.warn(f"skipping training pair '{key}' of {part.dataset.name}: {unreadable}", stacklevel=2)
        raise DataError(key, f"this pair and the {_ATTEMPTS - 1} before it cannot be read; check the data")

    def _part_of(self, place: int) -> tuple[OpenPart, str]:
        for part in self.parts:
            if place < len(part):
                return part, part.keys[place % len(part.keys)]
            place -= len(part)
        raise IndexError(place)

    def _augmented(self, position: int, part: OpenPart, key: str) -> TrainingPair:
        frames, flow, valid = _read(part.dataset, key, self.objective is None)
        drawn = draw_augmentation(
            Rng.of(self.seed, "augmentation", position), part.part, frames[0].shape[:2], self.crop
        )
        if self.objective is not None:
            return self._without_labels(position, f"{part.dataset.name} {key}", frames, flow, valid, drawn)
        frames, flow, valid = apply_augmentation(frames, flow, valid, drawn)
        if part.part.augmentation == "dense":
            valid = valid & (np.abs(flow) < _LONGEST).all(axis=2)
        if self.corruption is not None:
            frames = tuple(self.corruption(list(frames), key=f"training {self.seed} {position}"))
        return TrainingPair(
            _channels_first(frames[0]),
            _channels_first(frames[1]),
            _channels_first(flow),
            valid.astype(np.float32),
            f"{part.dataset.name} {key}",
        )

    def _without_labels(
        self, position: int, name: str, frames: tuple[Frame, Frame], flow: Flow, valid: Mask, drawn: Augmentation
    ) -> TrainingPair:
        """Return the pair for training without labels; its ground truth, if any, is only used for the log."""
        whole = augmented_whole(frames, drawn)
        if self.corruption is not None:
            whole = tuple(self.corruption(list(whole), key=f"training {self.seed} {position}"))
        flow, valid = augmented_truth(flow, valid, drawn)
        (height, width), top, left = drawn.crop, drawn.geometry.top, drawn.geometry.left
        cut = [frame[top : top + height, left : left + width] for frame in whole]
        around = None if isinstance(self.objective, ArflowObjective) else _uncropped(whole, (left, top))
        plain = None
        if isinstance(self.objective, BrightflowObjective):
            plain = _uncropped(augmented_whole(frames, replace(drawn, jitters=(), rectangles=())), (left, top))
        return TrainingPair(
            _channels_first(cut[0]),
            _channels_first(cut[1]),
            _channels_first(flow),
            valid.astype(np.float32),
            name,
            around,
            plain,
            self._second_pass(position, cut),
        )

    def _second_pass(
        self, position: int, crops: Sequence[Frame]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]] | None:
        objective = self.objective
        if not isinstance(objective, ArflowObjective | BrightflowObjective) or not objective.self_supervision:
            return None
        if isinstance(objective, BrightflowObjective):
            first, second = (without_border(crop, objective.border) for crop in crops)
        else:
            look = draw_look(Rng.of(self.seed, "appearance", position), objective.appearance)
            first, second = (apply_look(crop, look) for crop in crops)
        return _channels_first(first), _channels_first(second)


def _read(dataset: Dataset, key: str, labelled: bool) -> tuple[tuple[Frame, Frame], Flow, Mask]:
    """Return frames and ground truth, see `PairDataset.training_truth`. In training without labels, a pair without
    ground truth has no valid pixels."""
    flow: Flow | None
    valid: Mask | None
    if isinstance(dataset, PairDataset) and dataset.has_flow:
        pair = dataset.pair(key)
        first, second = read_frames(pair.frames)
        truth = dataset.training_truth(pair)
        flow, valid = (truth.flow, truth.valid) if truth is not None else (None, None)
    else:
        sample = dataset.load(key)
        (first, second), flow, valid = sample.frames[:2], sample.flow, sample.valid
    if flow is None or valid is None:
        if labelled:
            raise DataError("it has no ground truth to train on")
        flow, valid = np.zeros((*first.shape[:2], 2), np.float32), np.zeros(first.shape[:2], bool)
    if not np.isfinite(
        flow
    ).all():  # a user's dataset may mark unknown flow with NaN, which no mask removes from a loss
        flow = np.where(valid[..., None], flow, np.float32(0))
    if flow.shape[:2] != first.shape[:2]:
        raise DataError(
            f"its flow is {flow.shape[0]}x{flow.shape[1]}, but its frames are {first.shape[0]}x{first.shape[1]}"
        )
    return (first, second), flow, valid


def _uncropped(frames: tuple[Frame, Frame], corner: tuple[int, int]) -> Whole:
    return Whole(_channels_first(frames[0]), _channels_first(frames[1]), corner)


def _channels_first(array: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(array.transpose(2, 0, 1), dtype=np.float32)

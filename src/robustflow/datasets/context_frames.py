"""The frames around a pair, for multi-frame models: which exist, how they are read, corrupted by the pair's own draw,
and put in order.

Within a run they come after the pair, so that everything that uses a pair (metrics, digests, pictures) sees the pair
that a two-frame model gets, byte for byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..corruptions.api import corrupt_clip
from ..corruptions.base import Corruption
from ..errors import DataError, UsageError
from ..models.base import AnyModel, ClipModel, FlowModel
from ..models.window import Window, window_of
from ..sample import Frame, Sample
from . import DATASETS, dataset_facts
from .base import Clips, CorruptedClips, Dataset, PreCorrupted, has_clips


def window_on(model: AnyModel, dataset: Dataset) -> Window | None:
    """The window of a multi-frame model on a data set; None for a model that is given pairs.

    Raises:
        UsageError: the model needs more than two frames, but the data set has only pairs.
        ModelError: its window is not valid.
    """
    if not isinstance(model, ClipModel):
        return None
    window = window_of(model)
    frozen = isinstance(dataset, PreCorrupted) and not isinstance(dataset, CorruptedClips)
    if has_clips(dataset) and not frozen:
        return window
    if isinstance(model, FlowModel):
        return None
    raise UsageError(
        f"this model sees {window.before + 2 + window.after} frames, and '{dataset.name}' holds pairs only; "
        f"data with clips: {_with_clips()}"
    )


def _with_clips() -> str:
    """The data sets whose pairs have further frames around them, in words; those that always have them come first."""
    facts = {name: dataset_facts(name) for name in DATASETS.names()}
    with_clips = {facts.benchmark or name: facts.clips for name, facts in facts.items() if facts.clips != "never"}
    ordered = sorted(with_clips.items(), key=lambda entry: entry[1] != "always")
    return ", ".join(name if when == "always" else f"{name} {when}" for name, when in ordered)


class ContextFrames:
    """The frames of a window, on one data set.

    Frames travel as (frame 1, frame 2, those around them by ascending offset).
    """

    def __init__(self, dataset: Clips, window: Window) -> None:
        self._dataset = dataset
        self._window = window

    def offsets(self, key: str) -> tuple[int, ...]:
        """The offsets of the frames that the model is given, in its order; an offset may occur twice."""
        return self._window.offsets(self._dataset.around(key, self._window.reach))

    def files(self, key: str) -> list[Path]:
        """The files of the frames around a pair."""
        numbers = self._numbers(key)[2:]
        return self._dataset.frame_files(key, numbers) if numbers else []

    def add(self, sample: Sample) -> Sample:
        """The sample, with the frames around its pair added after the pair.

        Raises:
            DataError: one of them cannot be read, or differs in size.
        """
        around = {number: self._dataset.frame(sample.key, number) for number in self._numbers(sample.key)[2:]}
        for number, frame in around.items():
            if frame.shape != sample.frames[0].shape:
                raise DataError(
                    f"sample '{sample.key}': the frame {number} steps from its first is {frame.shape[1]}x"
                    f"{frame.shape[0]}, the pair {sample.shape[1]}x{sample.shape[0]}; all frames of a clip must have "
                    "one size"
                )
        return replace(sample, frames=(*sample.frames[:2], *around.values()))

    def corrupt(
        self, sample: Sample, corruption: Corruption, severity: int, seed: int, common_draws: bool = False
    ) -> tuple[Frame, ...]:
        """The frames of a sample from `add`, corrupted as one clip."""
        numbers = self._numbers(sample.key)
        first, clean = min(numbers), dict(zip(numbers, sample.frames, strict=True))
        clip = corrupt_clip(
            (clean[first + place] for place in range(len(clean))),
            corruption,
            severity,
            seed,
            sample.key,
            first=first,
            common_draws=common_draws,
        )
        corrupted = dict(zip(sorted(numbers), clip, strict=True))
        return tuple(corrupted[number] for number in numbers)

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """The frames that come already corrupted from the data set."""
        assert isinstance(self._dataset, CorruptedClips)
        return tuple(self._dataset.corrupted_frame(key, number, corruption, severity) for number in self._numbers(key))

    def in_order(self, key: str, frames: Sequence[Frame]) -> tuple[Frame, ...]:
        """The frames that the model is given, from those of a sample."""
        by_number = dict(zip(self._numbers(key), frames, strict=True))
        return tuple(by_number[offset] for offset in self.offsets(key))

    def _numbers(self, key: str) -> tuple[int, ...]:
        """The offsets of the frames of a sample, in their order."""
        return (0, 1, *sorted(set(self.offsets(key)) - {0, 1}))

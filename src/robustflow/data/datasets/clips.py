"""The frames around a pair, for multi-frame models: find and read them, corrupt them with the pair's random draw,
and put them in order.

Within a run, these frames come after the two frames of the pair, so that everything that uses a pair (metrics,
digests, pictures) sees the same bytes as with a two-frame model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...core.errors import UsageError
from ...core.plugins import called
from ...core.types import Frame, Sample, check_frame
from ...corruptions.api import corrupt_clip
from ...corruptions.corruption import Corruption
from ...models.protocols import AnyModel, ClipModel, FlowModel, Window, window_of
from . import DATASETS, dataset_facts
from .dataset import Clips, CorruptedClips, Dataset, PreCorrupted, has_clips, range_around


def window_on(model: AnyModel, dataset: Dataset) -> Window | None:
    """Return the window of a multi-frame model on a dataset, or None for a two-frame model."""
    if not isinstance(model, ClipModel):
        return None
    window = window_of(model)
    frozen = isinstance(dataset, PreCorrupted) and not isinstance(dataset, CorruptedClips)
    if has_clips(dataset) and not frozen:
        return window
    if isinstance(model, FlowModel):
        return None
    needed = f"this model needs {window.before + 2 + window.after} frames, but the dataset contains only pairs"
    raise UsageError(dataset.name, f"{needed}; datasets with clips: {_datasets_with_clips()}")


def _datasets_with_clips() -> str:
    facts = {name: dataset_facts(name) for name in DATASETS.names()}
    with_clips = {facts.benchmark or name: facts.clips for name, facts in facts.items() if facts.clips != "never"}
    ordered = sorted(with_clips.items(), key=lambda entry: entry[1] != "always")
    return ", ".join(name if when == "always" else f"{name} {when}" for name, when in ordered)


class ContextFrames:
    """The frames of a model's window on one dataset."""

    def __init__(self, dataset: Clips, window: Window) -> None:
        self._dataset = dataset
        self._window = window

    def offsets(self, key: str) -> tuple[int, ...]:
        """Return the offsets of the model's input frames, in the model's order; an offset may occur twice."""
        return self._window.offsets(range_around(self._dataset, key, self._window.reach))

    def files(self, key: str) -> list[Path]:
        numbers = self._numbers(key)[2:]
        if not numbers:
            return []
        culprit, doing = f"the dataset '{self._dataset.name}'", f"frame_files('{key}')"
        return called(culprit, doing, lambda: list(self._dataset.frame_files(key, numbers)))

    def add(self, sample: Sample) -> Sample:
        around = [self._frame(sample, number) for number in self._numbers(sample.key)[2:]]
        return replace(sample, frames=(*sample.frames[:2], *around))

    def _frame(self, sample: Sample, number: int) -> Frame:
        key = sample.key
        culprit, doing = f"the dataset '{self._dataset.name}'", f"frame('{key}', {number})"
        frame: Frame = called(culprit, doing, lambda: self._dataset.frame(key, number))
        check_frame(frame, sample.frames[0], f"sample '{key}', frame {number}")
        return frame

    def corrupt(self, sample: Sample, corruption: Corruption, severity: int, seed: int) -> tuple[Frame, ...]:
        numbers = self._numbers(sample.key)
        first, clean = min(numbers), dict(zip(numbers, sample.frames, strict=True))
        frames = (clean[first + place] for place in range(len(clean)))
        clip = corrupt_clip(frames, corruption, severity, seed, sample.key, first=first)
        corrupted = dict(zip(sorted(numbers), clip, strict=True))
        return tuple(corrupted[number] for number in numbers)

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        assert isinstance(self._dataset, CorruptedClips)
        return tuple(self._dataset.corrupted_frame(key, number, corruption, severity) for number in self._numbers(key))

    def in_order(self, key: str, frames: Sequence[Frame]) -> tuple[Frame, ...]:
        """Select the model's input frames from the frames of a sample."""
        by_number = dict(zip(self._numbers(key), frames, strict=True))
        return tuple(by_number[offset] for offset in self.offsets(key))

    def _numbers(self, key: str) -> tuple[int, ...]:
        return (0, 1, *sorted(set(self.offsets(key)) - {0, 1}))

"""The frames around a pair, for multi-frame models: find and read them, corrupt them with the pair's random draw,
and put them in order; and a video file as a dataset, decoded on demand in constant memory.

Within a run, these frames come after the two frames of the pair, so that everything that uses a pair (metrics,
digests, pictures) sees the same bytes as with a two-frame model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path

from ...core.arguments import positive
from ...core.errors import UsageError
from ...core.plugins import called
from ...core.types import Frame, Sample, check_frame
from ...corruptions.api import corrupt_clip
from ...corruptions.base import Corruption
from ...models.base import AnyModel, ClipModel, FlowModel, Window, window_of
from ..video.reader import VideoReader
from . import DATASETS, dataset_facts
from .base import Clips, CorruptedClips, Dataset, PreCorrupted, has_clips, range_around
from .pairs import Position, Samples, position, too_few_frames


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
        where = f"the dataset failed in frame_files('{key}')"
        return called(where, lambda: list(self._dataset.frame_files(key, numbers)))

    def add(self, sample: Sample) -> Sample:
        around = [self._frame(sample, number) for number in self._numbers(sample.key)[2:]]
        return replace(sample, frames=(*sample.frames[:2], *around))

    def _frame(self, sample: Sample, number: int) -> Frame:
        key = sample.key
        where = f"the dataset failed in frame('{key}', {number})"
        frame: Frame = called(where, lambda: self._dataset.frame(key, number))
        check_frame(frame, sample.frames[0], f"sample '{key}', frame {number}")
        return frame

    def corrupt(
        self, sample: Sample, corruption: Corruption, severity: int, seed: int, common_draws: bool = False
    ) -> tuple[Frame, ...]:
        numbers = self._numbers(sample.key)
        first, clean = min(numbers), dict(zip(numbers, sample.frames, strict=True))
        frames = (clean[first + place] for place in range(len(clean)))
        clip = corrupt_clip(frames, corruption, severity, seed, sample.key, first=first, common_draws=common_draws)
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


class Video(Samples):
    """A dataset of pairs of video frames `step` apart; keys are frame numbers from "000000". All pairs form one group,
    because frames of a video are not independent. Implements `Dataset` and `Clips`.
    """

    name = "folder"
    has_flow = False

    def __init__(self, path: Path, step: int = 1, start: Position = None, stop: Position = None) -> None:
        self._path, self._step = path, positive("step", step)
        self._readers = {0: VideoReader(path)}  # by offset: each decodes forward
        total = len(self._readers[0])
        begin, end = self._frame_number("start", start, 0), self._frame_number("stop", stop, total)
        self._end = min(end, total)
        if self._end - begin <= step:
            raise too_few_frames(max(0, self._end - begin), step, path, total)
        self._begin = begin
        self._keys = [f"{index:06d}" for index in range(begin, self._end - step)]

    def keys(self) -> list[str]:
        return list(self._keys)

    def files(self, key: str) -> list[Path]:
        self._index(key)
        return [self._path]

    def load(self, key: str) -> Sample:
        return Sample(key, (self.frame(key, 0), self.frame(key, 1)), group=self._path.stem)

    def around(self, key: str, reach: int) -> range:
        index = self._index(key)
        last = (self._end - 1 - index) // self._step
        return range(-min(reach, (index - self._begin) // self._step), min(reach + 1, last) + 1)

    def frame(self, key: str, offset: int) -> Frame:
        if offset not in self._readers:
            self._readers[offset] = copy(self._readers[0])  # a copy reopens the file
        return self._readers[offset].frame(self._index(key) + offset * self._step)

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.files(key)

    def frame_names(self, key: str) -> tuple[int, int]:
        index = self._index(key)
        return index, index + self._step

    def _index(self, key: str) -> int:
        number = int(key) - self._begin if key.isascii() and key.isdigit() and len(key) < 12 else -1
        if not 0 <= number < len(self._keys) or self._keys[number] != key:
            raise UsageError(key, f"no such sample; keys go from '{self._keys[0]}' to '{self._keys[-1]}'")
        return int(key)

    def _frame_number(self, option: str, value: Position, default: int) -> int:
        chosen = position(option, value)
        if chosen is None:
            return default
        return self._readers[0].index_at(chosen) if isinstance(chosen, float) else chosen

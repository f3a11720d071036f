"""Datasets as Python sequences, and datasets of image pairs in files, which are located when the dataset is opened, so
that a missing file is reported before a run starts.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from operator import index as whole_number
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...core.errors import DataError, UsageError
from ...core.text import counted
from ...core.types import Flow, Frame, Mask, Sample
from ...media.flow import read_flow
from ...media.images import read_image

if TYPE_CHECKING:
    from .dataset import Dataset


class Samples:
    """Mixin that makes a `Dataset` usable as a sequence, through its `keys` and `load`. Samples are read on access.

    >>> from robustflow.data.datasets import load_dataset
    >>> pairs = load_dataset("motorcycle")
    >>> pairs, len(pairs), pairs[0].key, pairs["motorcycle"].shape, [sample.key for sample in pairs]
    (<Motorcycle: 1 pair, with ground truth>, 1, 'motorcycle', (500, 741), ['motorcycle'])
    """

    def __len__(self: Dataset) -> int:
        return len(self.keys())

    def __iter__(self: Dataset) -> Iterator[Sample]:
        return (self.load(key) for key in self.keys())

    def __getitem__(self: Dataset, place: int | str) -> Sample:
        """Return one sample by its key or by its position; negative positions count from the end."""
        if isinstance(place, str):
            return self.load(place)
        return self.load(self.keys()[whole_number(place)])

    def __repr__(self: Dataset) -> str:
        truth = "with ground truth" if self.has_flow else "no ground truth"
        return f"<{type(self).__name__}: {counted(len(self.keys()), 'pair')}, {truth}>"


@dataclass(frozen=True)
class PairFiles:
    frames: tuple[Path, Path]
    flow: Path | None = None
    occlusion: Path | None = None
    invalid: Path | None = None
    group: str = ""

    def files(self) -> list[Path]:
        maps = (self.flow, self.occlusion, self.invalid)
        return [*self.frames, *(path for path in maps if path is not None)]


class Truth(NamedTuple):
    """Ground truth: flow float32 (H, W, 2), valid bool (H, W), occluded bool (H, W) or None."""

    flow: Flow
    valid: Mask
    occluded: Mask | None = None


class PairDataset(Samples):
    """Base class for datasets of `PairFiles`; a subclass overrides the reading of ground truth if necessary."""

    name: str = "folder"
    has_flow: bool = True
    non_occluded: bool = False
    """Whether the ground truth excludes pixels that are occluded in frame 2, contrary to the dataset's convention."""

    def __init__(self, pairs: Mapping[str, PairFiles], where: Path) -> None:
        if not pairs:
            raise DataError(where, f"contains no image pair of {self.name}; check that it was unpacked completely")
        self._pairs = dict(sorted(pairs.items()))

    def keys(self) -> list[str]:
        return list(self._pairs)

    def files(self, key: str) -> list[Path]:
        return self.pair(key).files()

    def load(self, key: str) -> Sample:
        pair = self.pair(key)
        frames = read_frames(pair.frames)
        truth = self.truth(pair)
        if truth is None:
            return Sample(key, frames, group=pair.group)
        if truth.flow.shape[:2] != frames[0].shape[:2]:
            raise DataError(pair.flow, f"{_size(truth.flow)}, but {pair.frames[0]} is {_size(frames[0])}")
        if not truth.valid.any():
            raise DataError(pair.flow, "no pixel with known flow, so nothing can be measured; restore the file")
        return Sample(key, frames, truth.flow, truth.valid, truth.occluded, group=pair.group, meta=self.describe(pair))

    def pair(self, key: str) -> PairFiles:
        if key not in self._pairs:
            close = get_close_matches(key, self._pairs, n=1, cutoff=0.5) or [next(iter(self._pairs))]
            raise UsageError(key, f"no such sample of {self.name}; keys look like '{close[0]}'")
        return self._pairs[key]

    def around(self, key: str, reach: int) -> range:
        first, second = self.pair(key).frames
        ahead, back = self._directions(first, second)
        return range(-len(_walk(back, first, reach)), 2 + len(_walk(ahead, second, reach)))

    def frame(self, key: str, offset: int) -> Frame:
        first = self.pair(key).frames[0]
        return read_frames((first, *self.frame_files(key, [offset])))[1]

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        return self.frames_around(key, offsets)

    def frames_around(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """Return the names of the frames at some offsets, in ascending order without duplicates."""
        ordered = sorted(set(offsets))
        first, second = self.pair(key).frames
        ahead, back = self._directions(first, second)
        earlier, later = _walk(back, first, max(0, -ordered[0])), _walk(ahead, second, max(0, ordered[-1] - 1))
        frames = [*reversed(earlier), first, second, *later]
        return [frames[len(earlier) + offset] for offset in ordered]

    def frame_names(self, key: str) -> tuple[Path, Path]:
        return self.pair(key).frames

    def steps(self) -> Iterable[tuple[Path, Path]]:
        """Return consecutive frames; override if there are frames outside the pairs."""
        return (pair.frames for pair in self._pairs.values())

    @cached_property
    def _steps(self) -> tuple[dict[Path, Path], dict[Path, Path]]:
        steps = list(self.steps())
        return dict(steps), {second: first for first, second in steps}

    def _directions(self, first: Path, second: Path) -> tuple[dict[Path, Path], dict[Path, Path]]:
        """Return the steps in the direction of a pair, and those against it; pairs may go back in time."""
        steps, reverse = self._steps
        return (reverse, steps) if reverse.get(first) == second else (steps, reverse)

    def truth(self, pair: PairFiles) -> Truth | None:
        """Read the ground truth of a pair; override if it is not just a flow file."""
        return None if pair.flow is None else Truth(*read_flow(pair.flow))

    def training_truth(self, pair: PairFiles) -> Truth | None:
        """Read the ground truth for training: only the flow file, as in the original code."""
        return PairDataset.truth(self, pair)

    def describe(self, pair: PairFiles) -> dict[str, Any]:
        return {}


def pairs_at_step(frames: Sequence[Path], step: int, where: Path, total: int = 0) -> list[tuple[Path, Path]]:
    """Pair each frame with the one `step` positions later; `total` is the count before a range was selected."""
    if len(frames) <= step:
        raise too_few_frames(len(frames), step, where, total)
    return list(zip(frames, frames[step:], strict=False))


def too_few_frames(count: int, step: int, where: Path, total: int = 0) -> DataError:
    frames = counted(count, "frame") + (f" of {total} from start to stop" if total > count else "")
    return DataError(where, f"{frames}, but pairs with a step of {step} need {step + 1} or more")


def read_frames(paths: tuple[Path, ...]) -> tuple[Frame, ...]:
    frames = tuple(read_image(path) for path in paths)
    for path, frame in zip(paths, frames, strict=True):
        if frame.shape != frames[0].shape:
            raise DataError(path, f"{_size(frame)}, but {paths[0]} is {_size(frames[0])}; resize one")
    return frames


def _walk(step: Mapping[Path, Path], frame: Path, most: int) -> list[Path]:
    """Return up to `most` frames after `frame`, in the direction of `step`."""
    neighbours: list[Path] = []
    while len(neighbours) < most and frame in step:
        frame = step[frame]
        neighbours.append(frame)
    return neighbours


def _size(array: Any) -> str:
    return f"{array.shape[0]}x{array.shape[1]}"


Position = int | str | None
"""A frame number from 0, a time such as "12.5s" or "1:05" (minutes and seconds), or None for the beginning or end."""


def position(option: str, value: Position | float) -> int | float | None:
    if value is None or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    text = str(value).strip()
    if text.isascii() and text.isdigit():
        return int(text)
    if match := re.fullmatch(r"(\d{1,6}(?:\.\d+)?) ?s", text):
        return float(match[1])
    if match := re.fullmatch(r"(?:(\d{1,3}):)?(\d{1,3}):([0-5]?\d(?:\.\d+)?)", text):
        return 3600.0 * int(match[1] or 0) + 60.0 * int(match[2]) + float(match[3])
    raise UsageError(option, f"cannot be {value!r}; give a frame number such as 120, or a time such as 12.5s or 1:05")

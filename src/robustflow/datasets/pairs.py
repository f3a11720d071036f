"""A data set of image pairs in files, which are located when it is opened, so that a missing file is noticed before a
run starts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import DataError, UsageError
from ..flowio import read_flow
from ..images.io import read_image
from ..sample import Flow, Frame, Mask, Sample
from ..text import counted
from .samples import Samples


@dataclass(frozen=True)
class PairFiles:
    """The files of one sample.

    Attributes:
        frames: the two pictures.
        flow: the ground truth, or None.
        occlusion: a map of occluded pixels, in the data set's own form, or None.
        invalid: a map of the pixels without ground truth, if that is a separate file, or None.
        group: the sequence; empty if samples are independent.
    """

    frames: tuple[Path, Path]
    flow: Path | None = None
    occlusion: Path | None = None
    invalid: Path | None = None
    group: str = ""

    def files(self) -> list[Path]:
        """All files of the pair."""
        maps = (self.flow, self.occlusion, self.invalid)
        return [*self.frames, *(path for path in maps if path is not None)]


class Truth(NamedTuple):
    """Ground truth: flow float32 (H, W, 2), valid bool (H, W), occluded bool (H, W) or None."""

    flow: Flow
    valid: Mask
    occluded: Mask | None = None


class PairDataset(Samples):
    """Samples from `PairFiles`; a reader finds the pairs, and overrides how its ground truth is read if that differs.

    Implements `Dataset` and `Clips`.
    """

    name: str = "folder"
    has_flow: bool = True
    non_occluded: bool = False
    """Whether the ground truth lacks the pixels that are hidden in frame 2, against the data set's own rule."""

    def __init__(self, pairs: Mapping[str, PairFiles], where: Path) -> None:
        if not pairs:
            raise DataError(f"{where}: no image pair of {self.name} found in it; check that it is completely unpacked")
        self._pairs = dict(sorted(pairs.items()))

    def keys(self) -> list[str]:
        """See `Dataset.keys`."""
        return list(self._pairs)

    def files(self, key: str) -> list[Path]:
        """See `Dataset.files`."""
        return self.pair(key).files()

    def load(self, key: str) -> Sample:
        """See `Dataset.load`."""
        pair = self.pair(key)
        frames = read_frames(pair.frames)
        truth = self.truth(pair)
        if truth is None:
            return Sample(key, frames, group=pair.group)
        if truth.flow.shape[:2] != frames[0].shape[:2]:
            raise DataError(
                f"{pair.flow}: the flow is {_size(truth.flow)}, the frame {pair.frames[0].name} is "
                f"{_size(frames[0])}; they do not belong together"
            )
        if not truth.valid.any():
            raise DataError(f"{pair.flow}: no pixel with known flow, so nothing to measure; restore the file")
        return Sample(key, frames, truth.flow, truth.valid, truth.occluded, group=pair.group, meta=self.describe(pair))

    def pair(self, key: str) -> PairFiles:
        """The files of a sample; raises a UsageError for an unknown key."""
        if key not in self._pairs:
            close = get_close_matches(key, self._pairs, n=1, cutoff=0.5) or [next(iter(self._pairs))]
            raise UsageError(f"{self.name} has no sample '{key}'; keys look like '{close[0]}'")
        return self._pairs[key]

    def around(self, key: str, reach: int) -> range:
        """See `Clips.around`."""
        first, second = self.pair(key).frames
        return range(-len(_walk(self._steps[1], first, reach)), 2 + len(_walk(self._steps[0], second, reach)))

    def frame(self, key: str, offset: int) -> Frame:
        """See `Clips.frame`."""
        first = self.pair(key).frames[0]
        return read_frames((first, *self.frame_files(key, [offset])))[1]

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """See `Clips.frame_files`."""
        wanted = sorted(set(offsets))
        before, (first, second) = max(0, -wanted[0]), self.pair(key).frames
        earlier = _walk(self._steps[1], first, before)
        later = _walk(self._steps[0], second, max(0, wanted[-1] - 1))
        frames = [*reversed(earlier), first, second, *later]
        return [frames[len(earlier) + offset] for offset in wanted]

    def frame_names(self, key: str) -> tuple[Path, Path]:
        """See `SharesFrames.frame_names`."""
        return self.pair(key).frames

    def steps(self) -> Iterable[tuple[Path, Path]]:
        """Consecutive frames; override if there are more than those of the pairs."""
        return (pair.frames for pair in self._pairs.values())

    @cached_property
    def _steps(self) -> tuple[dict[Path, Path], dict[Path, Path]]:
        """The frame after each frame, and the one before each."""
        steps = list(self.steps())
        return dict(steps), {second: first for first, second in steps}

    def truth(self, pair: PairFiles) -> Truth | None:
        """The ground truth of a pair; override if more than a flow file is read."""
        return None if pair.flow is None else Truth(*read_flow(pair.flow))

    def training_truth(self, pair: PairFiles) -> Truth | None:
        """The ground truth that networks are trained on: only the flow file, without maps of hidden or unreliable
        pixels, as in the original code; override if the flow needs more than its file."""
        return PairDataset.truth(self, pair)

    def describe(self, pair: PairFiles) -> dict[str, Any]:
        """The entries of `Sample.meta` about the ground truth."""
        return {}


def pairs_at_step(frames: Sequence[Path], step: int, where: Path) -> list[tuple[Path, Path]]:
    """Each frame with the one `step` further on; the last `step` frames begin no pair.

    Raises:
        DataError: too few frames for a single pair.
    """
    if len(frames) <= step:
        raise too_few_frames(len(frames), step, where)
    return list(zip(frames, frames[step:], strict=False))


def too_few_frames(count: int, step: int, where: Path) -> DataError:
    """The error for a sequence without a single pair."""
    return DataError(f"{where}: {counted(count, 'frame')}, but pairs at a step of {step} need {step + 1} or more")


def read_frames(paths: tuple[Path, ...]) -> tuple[Frame, ...]:
    """Read the frames of a pair.

    Raises:
        DataError: they differ in size; both files are named.
    """
    frames = tuple(read_image(path) for path in paths)
    for path, frame in zip(paths, frames, strict=True):
        if frame.shape != frames[0].shape:
            raise DataError(
                f"frames differ in size: {paths[0]} is {_size(frames[0])}, {path} is {_size(frame)}; "
                "both frames of a pair must have the same size"
            )
    return frames


def _walk(step: Mapping[Path, Path], frame: Path, most: int) -> list[Path]:
    """Up to `most` frames after `frame`, in the direction of `step`."""
    neighbours: list[Path] = []
    while len(neighbours) < most and frame in step:
        frame = step[frame]
        neighbours.append(frame)
    return neighbours


def _size(array: Any) -> str:
    return f"{array.shape[1]}x{array.shape[0]}"

"""What a data set is: named samples, and the files they come from."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from ..errors import UsageError
from ..sample import Frame, Sample, SceneDepth


@runtime_checkable
class Dataset(Protocol):
    """Samples by key. Any object with these members is a data set; no base class is needed.

    Implementations must be picklable, and hold no sample in memory between calls.

    Attributes:
        name: the name it is registered under.
        has_flow: whether every sample comes with ground truth.
    """

    name: str
    has_flow: bool

    def keys(self) -> list[str]:
        """All keys, in an order that is the same on every machine."""

    def load(self, key: str) -> Sample:
        """Read one sample.

        Raises:
            DataError: a file is damaged or does not fit the others.
            UsageError: no such key.
        """

    def files(self, key: str) -> list[Path]:
        """The files `load(key)` reads, to tell whether a sample is still the same."""


@runtime_checkable
class PreCorrupted(Protocol):
    """A data set that is distributed with its frames already corrupted."""

    def has_corrupted(self, corruption: str) -> bool:
        """Whether it holds this corruption, at one severity or more."""

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """The corrupted frames of a sample, RGB uint8 (H, W, 3).

        Raises:
            DataError: they are missing or damaged.
        """

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """The files `corrupted` reads."""


@runtime_checkable
class Depths(Protocol):
    """Where the depth of samples comes from: a data set that has it, or maps of the user's."""

    def depth(self, sample: Sample) -> SceneDepth:
        """The depth of a sample that was loaded.

        Raises:
            DataError: a file is missing, damaged, or does not fit the frames.
        """

    def depth_files(self, key: str) -> list[Path]:
        """The files that `depth` reads.

        Raises:
            DataError: one is missing.
            UsageError: there is no depth here.
        """


def no_depth(corruption: str, dataset: str) -> UsageError:
    """The error for a corruption that needs depth on a data set that has none."""
    return UsageError(
        f"{corruption} needs the depth of the scene, which '{dataset}' does not have: choose a data set that has it "
        "('robustflow list datasets'), or give your own maps with --depth DIR"
    )


@runtime_checkable
class Clips(Protocol):
    """A data set whose pairs come from sequences: it also has the frames around a pair, for multi-frame models.

    Frames are numbered by offsets from frame 1 of the pair, in steps of the pair: frame 1 is 0, frame 2 is 1, the frame
    before the pair -1, the one after it 2. If frame 2 comes before frame 1 in time, the offsets run backwards, too.
    """

    def around(self, key: str, reach: int) -> range:
        """The existing offsets, at most `reach` before and after the pair, including 0 and 1."""

    def frame(self, key: str, offset: int) -> Frame:
        """One of these frames, RGB uint8 (H, W, 3).

        Raises:
            DataError: it is damaged, or of another size than the pair.
        """

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """The files that `frame` reads, each once."""


@runtime_checkable
class CorruptedClips(Clips, PreCorrupted, Protocol):
    """A `PreCorrupted` data set that also has the frames around a pair, corrupted in the same way."""

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        """Like `frame`, but corrupted; offsets 0 and 1 give what `corrupted` gives."""


def has_clips(dataset: Dataset) -> bool:
    """Whether at least one pair of a data set has a frame before or after it."""
    if not isinstance(dataset, Clips):
        return False
    keys = dataset.keys()
    return any(len(dataset.around(key, 1)) > 2 for key in keys)


@runtime_checkable
class FromClips(Protocol):
    """A `PreCorrupted` data set that makes its frames from whole clips on demand."""

    def with_variant(self, variant: str) -> Dataset:
        """The same data with a different variant of the corruptions' parameters."""

    def clip_records(self) -> list[dict[str, Any]]:
        """The effects of each corruption on a clip so far (bytes changed, frames lost, "warnings"), for the
        manifest."""

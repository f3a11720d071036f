"""What a dataset is: the facts that a reader of results needs, and protocols of named samples and their files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

from pydantic import Field

from ...core.errors import UsageError
from ...core.plugins import called
from ...core.types import Frame, Frozen, Sample, SceneDepth

GroundTruth = Literal["dense", "sparse", "none"]

NON_COMMERCIAL = "non-commercial research only, see the distributor's terms"
"""The licence text for distributors who do not state a standard licence."""

OWN_FRAMES = "folder"
"""Registered name of the dataset of your own frames."""

FC_PAPER = "Yi et al., Benchmarking the Robustness of Optical Flow Estimation to Corruptions"


class DatasetFacts(Frozen):
    """The description of a dataset.

    Attributes:
        title: official name of the dataset.
        description: one-sentence description.
        ground_truth: "dense", "sparse" (a laser scanner, some pixels) or "none".
        pairs: number of pairs of the complete dataset when opened without options; None if the number varies.
        clips: availability of frames before and after the pairs, for multi-frame models: "always", "never", or a
            condition.
        depth: source of the depth of the pairs, for 3-D corruptions: "none" or a short description.
        licence: licence terms stated by the distributors; check them before use.
        citation: authors, title, venue, year.
        layout: folders that the root must contain.
        training_set: name of the training set that contains these frames, see `robustflow.models.provenance`; "" if
            there is none. If `same_domain` is also empty, no model can declare whether it was trained on these frames.
        same_domain: names of training sets of the same domain that contain different frames.
        benchmark: name of the benchmark that reads these files; "" if the dataset is evaluated under its own name.
        corruptions: corruptions that are distributed with the frames, each only at severity 1, if the dataset is
            evaluated under its own name; see `robustflow.corruptions.registry`. () if this package corrupts the frames.
        folder_options: names of options that specify an additional folder, which are not part of a run's identity.

    >>> DatasetFacts(title="Alley", ground_truth="none").clips
    'never'
    """

    title: str = Field(min_length=1, max_length=80)
    description: str = Field(default="", max_length=400)
    ground_truth: GroundTruth = "dense"
    pairs: int | None = Field(default=None, ge=1)
    clips: str = Field(default="never", max_length=80)
    depth: str = Field(default="none", max_length=80)
    licence: str = Field(default="not stated", max_length=200)
    citation: str = Field(default="none", max_length=400)
    layout: str = Field(default="", max_length=400)
    training_set: str = Field(default="", max_length=80)
    same_domain: tuple[str, ...] = ()
    benchmark: str = Field(default="", max_length=80)
    corruptions: tuple[str, ...] = ()
    folder_options: tuple[str, ...] = ()


T = TypeVar("T", bound=Callable[..., object])


def described(facts: DatasetFacts) -> Callable[[T], T]:
    """Attach facts to a function that opens a dataset (a decorator); a class declares them as its attribute `facts`."""

    def attach(function: T) -> T:
        function.facts = facts  # type: ignore[attr-defined]
        return function

    return attach


def facts_of(target: object, name: str) -> DatasetFacts:
    """Return the facts of a dataset's class or function, or facts with only a title if none are declared."""
    facts = getattr(target, "facts", None)
    if isinstance(facts, DatasetFacts):
        return facts
    truth: GroundTruth = "dense" if getattr(target, "has_flow", True) else "none"
    return DatasetFacts(title=name[:80], ground_truth=truth)


@runtime_checkable
class Dataset(Protocol):
    """Samples by key. Any object with these members is a dataset; no base class is needed.

    Implementations must be picklable, and must not keep samples in memory between calls.

    Attributes:
        name: registered name of the dataset.
        has_flow: whether every sample comes with ground truth.
    """

    name: str
    has_flow: bool

    def keys(self) -> list[str]:
        """Return all keys, in the same order on every machine."""

    def load(self, key: str) -> Sample:
        """Read one sample.

        Raises:
            DataError: a file is damaged or inconsistent with the rest of the sample.
            UsageError: the key does not exist.
        """

    def files(self, key: str) -> list[Path]:
        """Return the files that `load(key)` reads, which are hashed to detect a changed sample."""


@runtime_checkable
class PreCorrupted(Protocol):
    """A dataset that is distributed with corrupted frames."""

    def has_corrupted(self, corruption: str) -> bool:
        """Return whether the dataset contains this corruption at one or more severities."""

    def corrupted(self, key: str, corruption: str, severity: int) -> tuple[Frame, ...]:
        """Return the corrupted frames of a sample, RGB uint8 (H, W, 3)."""

    def corrupted_files(self, key: str, corruption: str, severity: int) -> list[Path]:
        """Return the files that `corrupted` reads."""


@runtime_checkable
class Depths(Protocol):
    """A source of depth for samples: a dataset with depth, or the user's depth maps."""

    def depth(self, sample: Sample) -> SceneDepth:
        """Return the depth of a loaded sample."""

    def depth_files(self, key: str) -> list[Path]:
        """Return the files that `depth` reads."""


def no_depth(corruption: str, dataset: str) -> UsageError:
    return UsageError(corruption, f"needs scene depth, which '{dataset}' lacks; give your own maps with --depth DIR")


@runtime_checkable
class Clips(Protocol):
    """A dataset that also provides the frames around a pair, for multi-frame models."""

    name: str

    def around(self, key: str, reach: int) -> range:
        """Return the available offsets, at most `reach` before and after the pair, including 0 and 1."""

    def frame(self, key: str, offset: int) -> Frame:
        """Return the frame at an offset, RGB uint8 (H, W, 3)."""

    def frame_files(self, key: str, offsets: Iterable[int]) -> list[Path]:
        """Return the files that `frame` reads, without duplicates."""


@runtime_checkable
class CorruptedClips(Clips, PreCorrupted, Protocol):
    """A `PreCorrupted` dataset that also provides the frames around a pair, corrupted in the same way."""

    def corrupted_frame(self, key: str, offset: int, corruption: str, severity: int) -> Frame:
        """Return the corrupted frame at an offset; offsets 0 and 1 are the frames that `corrupted` returns."""


def has_clips(dataset: Dataset) -> bool:
    if not isinstance(dataset, Clips):
        return False
    return any(len(range_around(dataset, key, 1)) > 2 for key in dataset.keys())  # noqa: SIM118


def range_around(dataset: Clips, key: str, reach: int) -> range:
    culprit, doing = f"the dataset '{dataset.name}'", f"around('{key}')"
    offsets = called(culprit, doing, lambda: dataset.around(key, reach))
    if not (isinstance(offsets, range) and offsets.step == 1 and 0 in offsets and 1 in offsets):
        raise UsageError(culprit, f"{doing} must return a range with 0 and 1, not {offsets!r:.60}")
    return offsets


@runtime_checkable
class FromClips(Protocol):
    """A `PreCorrupted` dataset that generates its frames from whole clips on demand."""

    def with_variant(self, variant: str) -> Dataset:
        """Return the same data with a different variant of the corruption parameters."""

    def clip_records(self) -> list[dict[str, Any]]:
        """Return the recorded effects of each corruption on a clip (bytes changed, frames lost, "warnings"), for the
        manifest."""

"""Facts about a dataset that a reader of results needs, as validated data on its class."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeVar

from pydantic import Field

from ..validated import Frozen

GroundTruth = Literal["dense", "sparse", "none"]

NON_COMMERCIAL = "non-commercial research only, see the distributor's terms"
"""The licence text for distributors who do not state a standard licence."""

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
            evaluated under its own name; see `robustflow.corruptions.on_disk`. () if this package corrupts the frames.
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
    """Return the facts of a dataset's class or function, or facts with only a title if none are declared.

    >>> facts_of(object(), "alley").title
    'alley'
    """
    facts = getattr(target, "facts", None)
    if isinstance(facts, DatasetFacts):
        return facts
    truth: GroundTruth = "dense" if getattr(target, "has_flow", True) else "none"
    return DatasetFacts(title=name[:80], ground_truth=truth)

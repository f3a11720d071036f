"""What a reader of a result needs to know about a data set: fields of its class, as validated data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field

GroundTruth = Literal["dense", "sparse", "none"]

NON_COMMERCIAL = "non-commercial research only, see the distributor's terms"
"""A licence in the words of those who state no standard one."""

FC_PAPER = "Yi et al., Benchmarking the Robustness of Optical Flow Estimation to Corruptions"


class DatasetFacts(BaseModel):
    """A data set in words.

    Attributes:
        title: what its authors call it.
        description: one sentence.
        ground_truth: "dense", "sparse" (a laser scanner, some pixels) or "none".
        pairs: how many pairs the whole data set has when it is opened without options; None where that varies.
        clips: there are frames before and after its pairs, for multi-frame models: "always", "never", or when.
        licence: the terms its distributors state; check them before use.
        citation: authors, title, venue, year.
        layout: the folders its root must hold.
        training_set: the training set that holds these frames, as `robustflow.models.provenance` calls it; "" where
            no model can say whether it saw them.
        same_domain: training sets of the same domain, which hold other frames.
        benchmark: the benchmark that reads these files; "" where the data set is evaluated under its own name.

    >>> DatasetFacts(title="Alley", ground_truth="none").clips
    'never'
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    title: str = Field(min_length=1, max_length=80)
    description: str = Field(default="", max_length=400)
    ground_truth: GroundTruth = "dense"
    pairs: int | None = Field(default=None, ge=1)
    clips: str = Field(default="never", max_length=80)
    licence: str = Field(default="not stated", max_length=200)
    citation: str = Field(default="none", max_length=400)
    layout: str = Field(default="", max_length=400)
    training_set: str = Field(default="", max_length=80)
    same_domain: tuple[str, ...] = ()
    benchmark: str = Field(default="", max_length=80)


class WithFacts(Protocol):
    """A class, or a function, that says what it is about."""

    facts: DatasetFacts


T = TypeVar("T", bound=Callable[..., object])


def described(facts: DatasetFacts) -> Callable[[T], T]:
    """Give a function that opens a data set its facts; a class has them as the attribute `facts`."""

    def attach(function: T) -> T:
        function.facts = facts  # type: ignore[attr-defined]
        return function

    return attach


def facts_of(target: object, name: str) -> DatasetFacts:
    """The facts of a data set's class or function; for one that states none, its name and nothing else.

    >>> facts_of(object(), "alley").title
    'alley'
    """
    facts = getattr(target, "facts", None)
    if isinstance(facts, DatasetFacts):
        return facts
    truth: GroundTruth = "dense" if getattr(target, "has_flow", True) else "none"
    return DatasetFacts(title=name[:80], ground_truth=truth)

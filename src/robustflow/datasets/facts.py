"""What a reader of a result needs to know about a data set: validated data on its class."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeVar

from pydantic import Field

from ..validated import Frozen

GroundTruth = Literal["dense", "sparse", "none"]

NON_COMMERCIAL = "non-commercial research only, see the distributor's terms"
"""The licence of distributors who do not state a standard one."""

FC_PAPER = "Yi et al., Benchmarking the Robustness of Optical Flow Estimation to Corruptions"


class DatasetFacts(Frozen):
    """The description of a data set.

    Attributes:
        title: its authors' name for it.
        description: one sentence.
        ground_truth: "dense", "sparse" (a laser scanner, some pixels) or "none".
        pairs: how many pairs the complete data set has when it is opened without options; None if that varies.
        clips: whether there are frames before and after its pairs, for multi-frame models: "always", "never", or a
            condition.
        depth: where the depth of its pairs comes from, for corruptions in three dimensions: "none", or in some words.
        licence: the terms its distributors state; check them before use.
        citation: authors, title, venue, year.
        layout: the folders that its root must hold.
        training_set: the name of the training set that holds these frames, see `robustflow.models.provenance`; "" if
            none does, or, without `same_domain`, no model can state whether it was trained on them.
        same_domain: training sets of the same domain, which hold other frames.
        benchmark: the benchmark that reads these files; "" if the data set is evaluated under its own name.
        corruptions: those that its frames come with, each only at severity 1, if they are evaluated under its own
            name; see `robustflow.corruptions.on_disk`. () if frames are corrupted here.
        folder_options: the options that name a further folder, and so are no part of what a run measured.

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
    """Decorator that attaches facts to a function that opens a data set; a class has them as the attribute `facts`."""

    def attach(function: T) -> T:
        function.facts = facts  # type: ignore[attr-defined]
        return function

    return attach


def facts_of(target: object, name: str) -> DatasetFacts:
    """The facts of a data set's class or function; only a title for one that states none.

    >>> facts_of(object(), "alley").title
    'alley'
    """
    facts = getattr(target, "facts", None)
    if isinstance(facts, DatasetFacts):
        return facts
    truth: GroundTruth = "dense" if getattr(target, "has_flow", True) else "none"
    return DatasetFacts(title=name[:80], ground_truth=truth)

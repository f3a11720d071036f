"""Facts about a benchmark that a reader of results needs, as validated data on its class."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from pydantic import Field

from ...core.arguments import SEVERITIES
from ...core.errors import UsageError
from ...core.types import Frozen
from ...corruptions import IMAGE_PAIR
from ..datasets.dataset import DatasetFacts


class QuickSubset(Frozen):
    """A subset of a benchmark's corruptions and severities whose ranking of models resembles that of the full set; its
    means are estimates. It was chosen using two rankings: one of published models, whose tables do not list
    severities, and one of models evaluated on different pairs.
    """

    corruptions: tuple[str, ...]
    severities: tuple[int, ...]
    tau: float
    tau_of_others: float
    published: int
    measured: int


class BenchmarkFacts(Frozen):
    """The description of a benchmark.

    Attributes:
        title: name of the benchmark in tables and figures.
        description: one-sentence description.
        data: what `--data` must specify; "" if the benchmark needs no data.
        has_flow: whether the samples have ground truth; if not, only RCRE is computed.
        published: whether the paper reports results on the benchmark.
        paper_corruptions: corruptions included in the paper's mean; for a benchmark that is not in the paper, the
            image-pair corruptions or those distributed with the frames.
        severities: available severities of the corruptions.
        paper_pairs: number of pairs in the paper's evaluation; None if the paper does not include the benchmark.
        lowest_ood_clean_epe: lowest clean EPE in the paper of a model that was not trained on the domain, pixels.
        training_set: name of the training set that contains the frames, see `robustflow.models.provenance`; "" if there
            is none. If `same_domain` is also empty, no model can declare whether it was trained on these frames.
        same_domain: names of training sets of the same domain that contain different frames.
        quick: conditions of `--subset quick`; None if no suitable subset exists.

    >>> BenchmarkFacts(title="Night drives").has_flow
    True
    """

    title: str = Field(min_length=1, max_length=80)
    description: str = Field(default="", max_length=400)
    data: str = Field(default="", max_length=200)
    has_flow: bool = True
    published: bool = False
    paper_corruptions: tuple[str, ...] = IMAGE_PAIR
    severities: tuple[int, ...] = SEVERITIES
    paper_pairs: int | None = Field(default=None, ge=1)
    lowest_ood_clean_epe: float | None = None
    training_set: str = Field(default="", max_length=80)
    same_domain: tuple[str, ...] = ()
    quick: QuickSubset | None = None


NON_OCCLUDED: dict[str, Any] = {"ground_truth": "non-occluded"}
"""Protocol entry of a run whose ground truth excludes pixels that are occluded in frame 2."""

EXPORTED: dict[str, Any] = {"frames": "exported"}
"""Protocol entry of a run on frames that this package wrote to a folder."""


def truth_remark(protocol: Mapping[str, Any]) -> str:
    """Return a remark about the ground truth of a run, or "" if it is the dataset's usual ground truth."""
    return "non-occluded ground truth" if NON_OCCLUDED.items() <= protocol.items() else ""


def estimate_remark(facts: BenchmarkFacts, corruptions: Collection[str], severities: Collection[int]) -> str:
    """Return a remark about means over the quick subset of a benchmark, or "" for means over other conditions."""
    quick = facts.quick
    if quick is None or set(corruptions) != set(quick.corruptions) or set(severities) != set(quick.severities):
        return ""
    models = f"{quick.published} published and {quick.measured} measured models"
    return f"an estimate from the quick subset, which ranks {models} like all conditions at a tau of {quick.tau:.2f}"


NEUTRAL = BenchmarkFacts(title="own benchmark")
"""Default facts for a benchmark that declares none."""


def facts_of_dataset(dataset: DatasetFacts) -> BenchmarkFacts:
    return BenchmarkFacts(
        title=dataset.title,
        description=dataset.description,
        data=dataset.layout,
        has_flow=dataset.ground_truth != "none",
        paper_corruptions=dataset.corruptions or IMAGE_PAIR,
        severities=SEVERITIES[:1] if dataset.corruptions else SEVERITIES,
        training_set=dataset.training_set,
        same_domain=dataset.same_domain,
    )


_STILL = "-still"
"""Suffix of the name of a still-scene benchmark."""


def still_name(name: str) -> str:
    return f"{name}{_STILL}"


def is_still(benchmark: str) -> bool:
    """Return whether a name denotes a still-scene benchmark, where every error is phantom motion."""
    return benchmark.endswith(_STILL)


def sample_noun(benchmark: str) -> str:
    return "still frame" if is_still(benchmark) else "pair"


def moving_name(benchmark: str) -> str:
    return benchmark.removesuffix(_STILL)


def facts_of_still(facts: BenchmarkFacts) -> BenchmarkFacts:
    title, description = f"{facts.title[:70]}, still", "Every frame paired with itself: any flow is phantom motion."
    changes = {"title": title, "description": description, "has_flow": True, "published": False}
    changes |= {"paper_pairs": None, "lowest_ood_clean_epe": None}
    return facts.model_copy(update=changes)


def check_still(name: str, facts: BenchmarkFacts) -> None:
    """Raise for a benchmark of the paper, whose name implies certain pairs and ground truth."""
    if facts.published:
        raise UsageError("--still", f"{name} has its own pairs and ground truth; use --benchmark kitti2015, ...")

"""What a reader of a result needs to know about a benchmark: validated data on its class."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from pydantic import Field

from ..corruptions import IMAGE_PAIR
from ..datasets.facts import DatasetFacts
from ..errors import UsageError
from ..severity import SEVERITIES
from ..validated import Frozen


class QuickSubset(Frozen):
    """Fewer corruptions and severities that rank models nearly as all of a benchmark's; its means are estimates. It was
    chosen on two rankings: of published models, whose tables have no severities, and of models measured on other pairs.

    Attributes:
        corruptions, severities: of the subset; every corruption at each of the severities.
        tau: the smallest of Kendall's tau between the rankings by EPE, CRE and RCRE, subset against all, in both.
        trials: in how many of 100 trials tau is at least 0.95 when the subset is chosen without one of the models.
        published: number of published models.
        measured: number of models measured.
    """

    corruptions: tuple[str, ...]
    severities: tuple[int, ...]
    tau: float
    trials: int
    published: int
    measured: int


class BenchmarkFacts(Frozen):
    """The description of a benchmark.

    Attributes:
        title: its name in tables and figures.
        description: one sentence.
        data: what `--data` should name; "" if it needs none.
        has_flow: whether its samples have ground truth; if not, only RCRE is measured.
        published: whether the paper has results on it.
        paper_corruptions: those that the paper's mean on it is over; for a benchmark that is not in the paper, the
            corruptions of image pairs, or those that its frames come with.
        severities: at which its corruptions exist.
        paper_pairs: on how many pairs the paper measured it; None if it does not say, or has no such benchmark.
        training_set: the training set that its frames come from, by its name in `robustflow.models.provenance`; "" if
            none holds them, or, without `same_domain`, no model can state whether it was trained on them.
        same_domain: training sets of the same domain, which hold other frames.
        quick: the conditions of `--subset quick`; None if none was found.

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
    training_set: str = Field(default="", max_length=80)
    same_domain: tuple[str, ...] = ()
    quick: QuickSubset | None = None


NON_OCCLUDED: dict[str, Any] = {"ground_truth": "non-occluded"}
"""Entry in the protocol of a run whose ground truth lacks the pixels that are hidden in frame 2."""


def truth_remark(protocol: Mapping[str, Any]) -> str:
    """What a reader has to know about the ground truth of a run; "" if it is its data set's usual one.

    >>> truth_remark(NON_OCCLUDED), truth_remark({})
    ('non-occluded ground truth', '')
    """
    return "non-occluded ground truth" if NON_OCCLUDED.items() <= protocol.items() else ""


def estimate_remark(facts: BenchmarkFacts, corruptions: Collection[str], severities: Collection[int]) -> str:
    """What a reader has to know about means over the quick subset of a benchmark; "" for those over others.

    >>> estimate_remark(NEUTRAL, ("fog",), (1,))
    ''
    """
    quick = facts.quick
    if quick is None or set(corruptions) != set(quick.corruptions) or set(severities) != set(quick.severities):
        return ""
    return (
        f"an estimate from the quick subset, which ranks {quick.published} published and {quick.measured} measured "
        f"models as all conditions do up to a Kendall's tau of {quick.tau:.2f}"
    )


NEUTRAL = BenchmarkFacts(title="own benchmark")
"""The facts of a benchmark that states none."""


def facts_of_dataset(dataset: DatasetFacts) -> BenchmarkFacts:
    """Any data set as a benchmark: every sample under every corruption of image pairs, or under its own."""
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
"""The end of the name of a benchmark in which nothing moves."""


def still_name(name: str) -> str:
    """The name of a benchmark whose frames are paired with themselves.

    >>> still_name("sintel")
    'sintel-still'
    """
    return f"{name}{_STILL}"


def is_still(benchmark: str) -> bool:
    """Whether nothing moves in a benchmark of this name, so that its errors are phantom motion.

    >>> is_still("sintel-still"), is_still("sintel")
    (True, False)
    """
    return benchmark.endswith(_STILL)


def sample_noun(benchmark: str) -> str:
    """What a sample of a benchmark is called when samples are counted.

    >>> sample_noun("sintel-still"), sample_noun("sintel")
    ('still frame', 'pair')
    """
    return "still frame" if is_still(benchmark) else "pair"


def moving_name(benchmark: str) -> str:
    """The name of the benchmark that the frames of a still one come from; other names as they are.

    >>> moving_name("sintel-still"), moving_name("sintel")
    ('sintel', 'sintel')
    """
    return benchmark.removesuffix(_STILL)


def facts_of_still(facts: BenchmarkFacts) -> BenchmarkFacts:
    """The facts of a benchmark whose frames are paired with themselves: every pixel has a known flow, which is zero."""
    return facts.model_copy(
        update={
            "title": f"{facts.title[:70]}, still",
            "description": "Every frame paired with itself: any flow is phantom motion.",
            "has_flow": True,
            "published": False,
            "paper_pairs": None,
        }
    )


def check_still(name: str, facts: BenchmarkFacts) -> None:
    """Raise if the name of a benchmark implies its pairs and their ground truth, as the paper's do, so that still
    scenes under it would mislead.

    Raises:
        UsageError: it does.
    """
    if facts.published:
        raise UsageError(
            f"{name} is a benchmark of moving scenes, with its own pairs and ground truth; for still scenes name a "
            "data set instead: --benchmark kitti2015, folder, ... with --still"
        )

"""The paper's ten observations, each checked against results by a computation that returns a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...text import counted
from ..model_result import ModelResult
from ..published.tables import Method
from .corruptions import dark_and_overexposed, local_information
from .evidence import Evidence
from .fine_tuning import fine_tuning_costs_robustness, weather_is_why
from .gopro import flowformer_is_best, foundation_model_does_not_help
from .models import (
    accuracy_and_robustness,
    cost_considered,
    samflow_and_csflow,
    unsupervised_are_stable,
)
from .verdict import Observation, Statement, Verdict, without_verdict

__all__ = ["Observation", "Statement", "Verdict", "observations"]

LEAST_FAMILIES = 5
LEAST_PAIRS = 20
"""Minimum number of image pairs for a verdict; `LEAST_FAMILIES` is the minimum number of model families."""

_OF_RCRE = (9, 10)
_OBSERVATIONS = (
    accuracy_and_robustness,
    samflow_and_csflow,
    unsupervised_are_stable,
    fine_tuning_costs_robustness,
    weather_is_why,
    cost_considered,
    dark_and_overexposed,
    local_information,
    flowformer_is_best,
    foundation_model_does_not_help,
)


def observations(
    results: Sequence[ModelResult],
    methods: Mapping[str, Method] | None = None,
) -> list[Observation]:
    """Check the paper's observations against results.

    Args:
        results: published results or results of runs, not both, measured on the same frames per benchmark.
        methods: model name -> method; by default, those of the paper's models.

    The verdict is "holds" or "does not hold" only if the 95 % interval excludes the opposite. For statements about
    models in general, intervals are over families (variants of one method count once); for statements about named
    models, over corruptions. On fewer than `LEAST_PAIRS` image pairs, or with fewer than `LEAST_FAMILIES` families of
    models, the verdict is always "too little evidence".

    >>> from robustflow.analysis.published.tables import published_results
    >>> checked = observations(published_results())
    >>> [observation.number for observation in checked if observation.verdict == "holds"]
    [3, 4, 6, 7, 8]
    """
    evidence = Evidence(results, methods)
    checked = [observe(evidence) for observe in _OBSERVATIONS]
    families = {
        of_rcre: len(set(map(evidence.family, evidence.rcre if of_rcre else evidence.entries)))
        for of_rcre in (True, False)
    }
    pairs = next((line.pairs for line in results if line.pairs is not None), None)
    return [_check_evidence(one, families[one.number in _OF_RCRE], pairs) for one in checked]


def _check_evidence(observation: Observation, families: int, pairs: int | None) -> Observation:
    few = []
    if families < LEAST_FAMILIES:
        words = counted(families, "family of models", "families of models")
        few.append(f"{words}, but at least {LEAST_FAMILIES} are needed")
    if pairs is not None and pairs < LEAST_PAIRS:
        few.append(f"{counted(pairs, 'image pair')}, but at least {LEAST_PAIRS} are needed")
    return without_verdict(observation, "; ".join(few)) if few else observation

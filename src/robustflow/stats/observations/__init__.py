"""The paper's ten observations, each checked against its results by a computation that returns a verdict."""

from __future__ import annotations

from collections.abc import Sequence

from ..model_result import ModelResult
from .corruptions import dark_and_overexposed, fine_tuning_costs_robustness, local_information, weather_is_why
from .evidence import Evidence, Observation, Statement, Verdict
from .gopro import flowformer_is_best, foundation_model_does_not_help
from .models import accuracy_and_robustness, cost_considered, samflow_and_csflow, unsupervised_are_stable

__all__ = ["Observation", "Statement", "Verdict", "observations"]

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


def observations(results: Sequence[ModelResult]) -> list[Observation]:
    """Check the paper's observations against its results (`published_results`)."""
    evidence = Evidence(results)
    return [observe(evidence) for observe in _OBSERVATIONS]

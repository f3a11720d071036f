"""Combine an objective with its network."""

from __future__ import annotations

from ...errors import UsageError
from ..networks import TrainedNetwork
from ..objectives import ArflowObjective, BrightflowObjective, UpflowObjective
from ..recipe import Recipe
from .arflow import Arflow
from .brightflow import Brightflow
from .objective import LabelFree
from .upflow import Upflow


def build_objective(network: TrainedNetwork, recipe: Recipe) -> LabelFree:
    """Return the module that computes the loss of a recipe without labels.

    Raises:
        UsageError: the method does not support the crop.
    """
    settings = recipe.objective
    if isinstance(settings, ArflowObjective):
        return Arflow(network, recipe, settings)
    if isinstance(settings, BrightflowObjective):
        if min(recipe.crop) <= 2 * settings.border:
            raise UsageError(
                f"crop {recipe.crop[0]}x{recipe.crop[1]}: brightflow's student does not use the outer "
                f"{settings.border} pixels of the crop, so each side needs more than {2 * settings.border}; use a "
                "larger --crop"
            )
        return Brightflow(network, recipe, settings)
    assert isinstance(settings, UpflowObjective)
    return Upflow(network, recipe, settings)

"""Find the PyTorch network inside a model, and count the cost of the model's predictions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..errors import UsageError
from ..models.tiling import TiledModel
from ..models.torch.clip_model import TorchClipModel
from ..models.torch.model import NetworkModel
from .counts import Counts, count


def network_of(model: Any) -> NetworkModel:
    """Return the adapter that contains a model's network, without the tiling wrapper."""
    while isinstance(model, TiledModel):
        model = model.model
    if isinstance(model, TorchClipModel):
        raise UsageError(
            f"'{model.name}' needs a clip, but only two-frame networks can be profiled: choose a different model"
        )
    if not isinstance(model, NetworkModel):
        raise UsageError(
            "only PyTorch networks can be profiled, but this model does not expose one; choose a model that "
            "robustflow list models shows with the source own, ptlflow or torchvision"
        )
    return model


def count_prediction(model: Any, height: int, width: int) -> Counts:
    """Count the cost of one prediction on frames of this size, over all tiles if the model predicts in tiles."""
    network = network_of(model)
    tiles, size = model.tiles(height, width) if isinstance(model, TiledModel) else (1, (height, width))
    one = count(network.net, *network.convention.fitted_size(*size))
    return replace(one, macs=tiles * one.macs, thop_macs=tiles * one.thop_macs)

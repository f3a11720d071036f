"""Find the PyTorch network inside a model."""

from __future__ import annotations

from typing import Any

from ..errors import UsageError
from ..models.tiling import TiledModel
from ..models.torch.clip_model import TorchClipModel
from ..models.torch.model import NetworkModel


def network_of(model: Any) -> NetworkModel:
    """Return the adapter that contains a model's network, without the tiling wrapper.

    Raises:
        UsageError: the model does not contain a supported PyTorch network, or needs more than two frames.
    """
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

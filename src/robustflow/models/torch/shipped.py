"""Build a PyTorch network with weights shipped in the package."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from ..execution import Execution
from ..input_convention import InputConvention
from ..tiny.shipped import ShippedWeights
from .model import NetworkModel


def shipped_network(
    name: str,
    weights: ShippedWeights,
    build: Callable[[], nn.Module],
    convention: InputConvention,
    execution: Execution,
) -> NetworkModel:
    """Build a model from the network with the shipped weights.

    Raises:
        UsageError, ModelError: the device is unknown or not available, see `NetworkModel`.
    """
    net = build()
    net.load_state_dict({key: torch.from_numpy(array.copy()) for key, array in weights.arrays.items()})
    model = NetworkModel(name, net, convention, {"checkpoint": weights.sha256, "runtime": "torch"}, execution)
    model.trained_on = weights.trained_on
    return model

"""A multi-frame PyTorch network as a flow model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ...errors import UsageError
from ...sample import Flow, Frame
from ..pairs import check_pair
from ..window import Window
from .model import NetworkModel


class TorchClipModel:
    """A multi-frame network; satisfies `ClipModel`."""

    def __init__(self, network: NetworkModel, window: Window) -> None:
        self.window = window
        self._network = network

    @property
    def name(self) -> str:
        """The model's name."""
        return self._network.name

    @property
    def net(self) -> torch.nn.Module:
        """The network."""
        return self._network.net

    @property
    def device(self) -> torch.device:
        """The network's device."""
        return self._network.device

    def identity(self) -> dict[str, Any]:
        """Return the identity of the network. The window is only part of a run's identity if it is used."""
        return self._network.identity()

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """Predict a flow as in `ClipModel.predict_clip`."""
        for frame in frames:
            check_pair(frames[0], frame)
        if not 0 <= index < len(frames) - 1:
            raise UsageError(f"{len(frames)} frames contain no pair at index {index}")
        return self._network.run(*([frame] for frame in frames), index=index)[0]


class TorchStreamModel(TorchClipModel):
    """A multi-frame network that can also predict from two frames; also satisfies `FlowModel`."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`, treating the pair as the first of a sequence."""
        return self.predict_clip((frame1, frame2), 0)

"""A multi-frame PyTorch network as a flow model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ...errors import UsageError
from ...sample import Flow, Frame
from ..window import Window
from .model import NetworkModel


class TorchClipModel:
    """Satisfies `ClipModel`.

    Args:
        network: its net takes images (1, 3, H, W) in the order of time, and `index`.
        window: the frames that it needs.
    """

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
        """See `NetworkModel.identity`; the window is in a run's identity where it is used."""
        return self._network.identity()

    def predict_clip(self, frames: Sequence[Frame], index: int) -> Flow:
        """See `ClipModel.predict_clip`.

        Raises:
            UsageError: no pair at `index`.
        """
        if not 0 <= index < len(frames) - 1:
            raise UsageError(f"{len(frames)} frames have no pair at index {index}")
        return self._network.run(*([frame] for frame in frames), index=index)[0]


class TorchStreamModel(TorchClipModel):
    """A network that works with two frames and improves with those before them. Also satisfies `FlowModel`."""

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`: the first pair of a sequence."""
        return self.predict_clip((frame1, frame2), 0)

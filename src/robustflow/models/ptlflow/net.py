"""Wrap a network of ptlflow so that it is called like the project's own: two images in, one flow out."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from ...errors import ModelError


class PtlflowNet(nn.Module):
    """Gives a ptlflow model its dictionary of images and takes the flow out of the one it returns.

    The model itself scales, pads and converts to RGB.

    Args:
        model: of ptlflow.
        batched: whether the pairs of a batch are known not to see each other; else each is predicted separately.
    """

    def __init__(self, model: Any, batched: bool) -> None:
        super().__init__()
        self.model = model
        self.batched = batched

    def forward(self, image1: Tensor, image2: Tensor, confidence: bool = False) -> Tensor:
        """Predict a flow (N, 2, H, W) in pixels from images (N, 3, H, W), BGR, 0..255; (N, 3, H, W) with the confidence
        of networks that return one."""
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        if self.batched:
            return self._flow(images, confidence)
        return torch.cat([self._flow(pair, confidence) for pair in images.split(1)])

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """The flow after every iteration, for the loss; in training mode only.

        Raises:
            ModelError: a network of ptlflow that keeps its intermediate flows to itself.
        """
        return self._in_training(image1, image2)[0]

    def matched_predictions(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Likewise, with GMFlowNet's confidence (N, P, P) that a pixel of 1/8 matches one of the other frame.

        Raises:
            ModelError: a network that does not match.
        """
        flows, outputs = self._in_training(image1, image2)
        if "soft_corr_map" not in outputs:
            raise ModelError("this network of ptlflow matches nothing before its iterations; take the loss 'sequence'")
        return flows, outputs["soft_corr_map"]

    def _in_training(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        outputs = self.model({"images": images})
        if "flow_preds" not in outputs:
            raise ModelError(
                "this network of ptlflow keeps the flows of its iterations to itself; it cannot be trained here"
            )
        return list(outputs["flow_preds"]), outputs

    def _flow(self, images: Tensor, confidence: bool) -> Tensor:
        outputs = self.model({"images": images})
        flows: Tensor = outputs["flows"]
        if flows.ndim != 5 or flows.shape[1] != 1:
            raise ModelError(
                f"the network returned flows of shape {tuple(flows.shape)} for two frames, not one flow; "
                "it is made for more frames: choose a two-frame model"
            )
        return torch.cat([flows[:, 0], outputs["confs"][:, 0]], dim=1) if confidence else flows[:, 0]

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


_STRIDE = 8
"""Pixels of a crop for one of the cost volume; the sides of a crop are multiples of it."""


class FlowFormerPlusPlusNet(PtlflowNet):
    """FlowFormer++ (Shi et al., CVPR 2023), computed as its authors' code does where ptlflow 0.4.2 differs.

    ptlflow hands the contexts of a batch to the cost tokens in the order of FlowFormer, where pairs see each other; in
    the authors' code each pair's context goes with its own eight tokens. And ptlflow pads the crops of a training to
    multiples of 32, which the authors take as they are.
    """

    def __init__(self, model: Any) -> None:
        super().__init__(model, batched=True)
        for module in model.modules():
            if hasattr(module, "context_proj"):
                module.register_forward_pre_hook(_with_own_context)

    def _in_training(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        padded_to, self.model.output_stride = self.model.output_stride, _STRIDE
        try:
            return super()._in_training(image1, image2)
        finally:
            self.model.output_stride = padded_to


def _with_own_context(attention: nn.Module, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    """Repeat each pair's context (N, C, H, W) for its tokens (N * K, H * W, D), so that ptlflow has nothing to tile."""
    tokens, size, context = inputs
    return tokens, size, context.repeat_interleave(len(tokens) // len(context), dim=0)

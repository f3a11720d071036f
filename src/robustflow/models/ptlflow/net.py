"""Wrap a ptlflow network in the project's interface: two images in, one flow out."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from ...core.errors import ModelError


class PtlflowNet(nn.Module):
    """Call a ptlflow model with its dictionary of images and extract the flow from the dictionary it returns."""

    def __init__(self, model: Any, batched: bool) -> None:
        super().__init__()
        self.model = model
        self.batched = batched

    def forward(self, image1: Tensor, image2: Tensor, confidence: bool = False) -> Tensor:
        """Predict a flow (N, 2, H, W) in pixels from images (N, 3, H, W), BGR, 0..255. For networks that return a
        confidence, the result is (N, 3, H, W) and includes the confidence.
        """
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        if self.batched:
            return self._flow(images, confidence)
        return torch.cat([self._flow(pair, confidence) for pair in images.split(1)])

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after every iteration, for the loss; in training mode only."""
        return self._training_outputs(image1, image2)[0]

    def matched_predictions(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the flow after every iteration and GMFlowNet's matching confidence between pixels of the two frames at
        1/8 resolution, (N, P, P).
        """
        flows, outputs = self._training_outputs(image1, image2)
        if "soft_corr_map" not in outputs:
            raise ModelError("this ptlflow network has no matching step before its iterations; use the loss 'sequence'")
        return flows, outputs["soft_corr_map"]

    def _training_outputs(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        images = torch.stack([image1, image2], dim=1).contiguous() / 255
        outputs = self.model({"images": images})
        if "flow_preds" not in outputs:
            raise ModelError(
                "this ptlflow network does not return the flows of its iterations, so robustflow cannot train it"
            )
        return list(outputs["flow_preds"]), outputs

    def _flow(self, images: Tensor, confidence: bool) -> Tensor:
        outputs = self.model({"images": images})
        flows: Tensor = outputs["flows"]
        if flows.ndim != 5 or flows.shape[1] != 1:
            raise ModelError(
                f"the network returned flows of shape {tuple(flows.shape)} for two frames, not a single "
                "flow; it is a multi-frame network: choose a two-frame model"
            )
        return torch.cat([flows[:, 0], outputs["confs"][:, 0]], dim=1) if confidence else flows[:, 0]


_STRIDE = 8
"""Number of image pixels per pixel of the cost volume along each axis; the side lengths of a crop are multiples of
this number."""


class FlowFormerPlusPlusNet(PtlflowNet):
    """FlowFormer++ (Shi et al., CVPR 2023), modified to match the authors' code where ptlflow 0.4.2 differs from it."""

    def __init__(self, model: Any) -> None:
        super().__init__(model, batched=True)
        for module in model.modules():
            if hasattr(module, "context_proj"):
                module.register_forward_pre_hook(_with_own_context)

    def _training_outputs(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], dict[str, Tensor]]:
        padded_to, self.model.output_stride = self.model.output_stride, _STRIDE
        try:
            return super()._training_outputs(image1, image2)
        finally:
            self.model.output_stride = padded_to


def _with_own_context(attention: nn.Module, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    """Repeat each pair's context (N, C, H, W) for its tokens (N * K, H * W, D), so that ptlflow does not tile it."""
    tokens, size, context = inputs
    return tokens, size, context.repeat_interleave(len(tokens) // len(context), dim=0)


class CraftNet(PtlflowNet):
    """CRAFT (Sui et al., CVPR 2022), modified to work in mixed precision as in the authors' code: ptlflow 0.4.2 writes
    its position biases, which are weights in float32, into an array with the type of the features, and fails."""

    def __init__(self, model: Any) -> None:
        super().__init__(model, batched=True)
        for module in model.modules():
            if type(module).__name__ == "SlidingPosBiases2D":
                module.register_forward_pre_hook(_in_dtype_of_biases)


def _in_dtype_of_biases(module: nn.Module, inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    shape, _, device = inputs
    return shape, module.biases.dtype, device

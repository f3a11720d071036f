"""FlowFormer++ (Shi et al., CVPR 2023) of ptlflow, computed as its authors' code does where ptlflow 0.4.2 differs.

ptlflow hands the contexts of a batch to the cost tokens in the order of FlowFormer, where pairs see each other; in the
authors' code each pair's context goes with its own eight tokens. And ptlflow pads the crops of a training to multiples
of 32, which the authors take as they are.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from .net import PtlflowNet

_STRIDE = 8
"""Pixels of a crop for one of the cost volume; the sides of a crop are multiples of it."""


class FlowFormerPlusPlusNet(PtlflowNet):
    """See `PtlflowNet`; the pairs of a batch do not see each other."""

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

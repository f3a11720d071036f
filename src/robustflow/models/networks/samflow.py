"""SAMFlow (Zhou et al., AAAI 2024): FlowFormer whose context includes Segment Anything's features of image 1."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from .blocks.twins import Twins
from .flowformer import MemoryDecoder, MemoryEncoder
from .sam_adapter import ContextAdapter, FusionBlock
from .sam_vit import VIT_B, VIT_H, SamVit
from .tiny_vit import TinyVit

_SAM_MEAN, _SAM_STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


class _WeightedAdd(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.add_weight = nn.Parameter(torch.tensor([1.0, 0.0]))

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        return self.add_weight[0] * first + self.add_weight[1] * second


class SamFlow(nn.Module):
    """The published model in one of its four sizes; the state-dict keys are the same as in the authors' checkpoints."""

    def __init__(
        self, size: Literal["tiny", "base", "huge"] = "tiny", finetuned: bool = False, iterations: int = 12
    ) -> None:
        super().__init__()
        self.iterations = iterations
        self.memory_encoder = MemoryEncoder()
        self.memory_decoder = MemoryDecoder()
        self.context_encoder = Twins(large=True)
        if size == "tiny":
            self.sam_encoder: nn.Module = TinyVit()
        else:
            self.sam_encoder = SamVit(VIT_B if size == "base" else VIT_H, first_rows=finetuned)
        self.wadd_1 = None if size == "huge" and not finetuned else _WeightedAdd()
        self.up_layer8 = nn.Sequential(
            nn.Conv2d(256, 96, 3, padding=1), nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False)
        )
        self.CFM = nn.Sequential(FusionBlock(256 + 96), FusionBlock(256))
        self.LTSE = nn.ModuleDict({"LTSE_embed": nn.Embedding(1, 256)})  # the learned embedding of the flow task
        self.CAM = ContextAdapter()
        self.register_buffer("sam_mean", torch.tensor(_SAM_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("sam_std", torch.tensor(_SAM_STD).view(3, 1, 1), persistent=False)

    def fused_context(self, image1: Tensor) -> Tensor:
        """Return the fused features of the context network and SAM, (N, 256, H / 8, W / 8), for RGB images (N, 3, H, W)
        in 0..255.
        """
        sam = self.up_layer8(self.sam_encoder((image1 - self.sam_mean) / self.sam_std))
        return self.CFM(torch.cat((self.context_encoder(2 * image1 / 255 - 1), sam), dim=1))

    def context(self, image1: Tensor) -> Tensor:
        """Return the sum of the fused context and the adapter's output."""
        fused = self.fused_context(image1)
        adapted = self.CAM(fused, self.LTSE["LTSE_embed"].weight)
        return fused + adapted if self.wadd_1 is None else self.wadd_1(fused, adapted)

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        """Return the flow from image 1 to image 2, (N, 2, H, W) in pixels; arguments as for `flows`."""
        return self._decode(image1, image2, every=False)[0][-1]

    def predictions(self, image1: Tensor, image2: Tensor) -> list[Tensor]:
        """Return the flow after every iteration, for the loss; arguments as for `flows`."""
        return self.flows(image1, image2)[0]

    def flows(self, image1: Tensor, image2: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the flow after every iteration, for the loss."""
        return self._decode(image1, image2, every=True)

    def _decode(self, image1: Tensor, image2: Tensor, every: bool) -> tuple[list[Tensor], Tensor]:
        context = self.context(image1)
        cost_maps, memory = self.memory_encoder(2 * image1 / 255 - 1, 2 * image2 / 255 - 1, context)
        return self.memory_decoder(cost_maps, memory, context, self.iterations, every)

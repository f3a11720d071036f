"""SAMFlow (Zhou et al., AAAI 2024): FlowFormer whose context includes Segment Anything's features of image 1."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend
from .blocks.twins import Twins
from .flowformer import MemoryDecoder, MemoryEncoder
from .sam_encoders import VIT_B, VIT_H, SamVit, TinyVit

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
        """Return the fused features of the context network and SAM, (N, 256, H / 8, W / 8)."""
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


_WIDTH, _HEADS = 256, 8


class FusionBlock(nn.Module):
    """A residual block of two convolutions with group norm."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, _WIDTH, 3, padding=1)
        self.conv2 = nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1)
        self.norm1 = nn.GroupNorm(32, _WIDTH)
        self.norm2 = nn.GroupNorm(32, _WIDTH)
        self.downsample: nn.Sequential | None = None
        if inputs != _WIDTH:
            self.norm3 = nn.GroupNorm(32, _WIDTH)
            self.downsample = nn.Sequential(nn.Conv2d(inputs, _WIDTH, 1), self.norm3)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, 256, H, W)."""
        y = F.relu(self.norm1(self.conv1(x)))
        y = F.relu(self.norm2(self.conv2(y)))
        return F.relu(y + (x if self.downsample is None else self.downsample(x)))


class Attention(nn.Module):
    """Attention with eight heads and a configurable inner width."""

    def __init__(self, inner: int) -> None:
        super().__init__()
        self.q_proj = nn.Linear(_WIDTH, inner)
        self.k_proj = nn.Linear(_WIDTH, inner)
        self.v_proj = nn.Linear(_WIDTH, inner)
        self.out_proj = nn.Linear(inner, _WIDTH)

    def forward(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        """Map queries (N, Q, 256), keys (N, K, 256) and values (N, K, 256) to (N, Q, 256)."""
        return self.out_proj(attend(self.q_proj(query), self.k_proj(key), self.v_proj(value), _HEADS))


class TwoWayBlock(nn.Module):
    """Attention among the tokens, to the image, an MLP, attention from the image; each with residual and norm."""

    def __init__(self, first: bool) -> None:
        super().__init__()
        self.first = first
        self.self_attn = Attention(_WIDTH)
        self.norm1 = nn.LayerNorm(_WIDTH)
        self.cross_attn_token_to_image = Attention(_WIDTH // 2)
        self.norm2 = nn.LayerNorm(_WIDTH)
        layers = {"lin1": nn.Linear(_WIDTH, 2048), "relu": nn.ReLU(), "lin2": nn.Linear(2048, _WIDTH)}
        self.mlp = nn.Sequential(OrderedDict(layers))
        self.norm3 = nn.LayerNorm(_WIDTH)
        self.norm4 = nn.LayerNorm(_WIDTH)
        self.cross_attn_image_to_token = Attention(_WIDTH // 2)

    def forward(self, tokens: Tensor, image: Tensor, token_code: Tensor, image_code: Tensor) -> tuple[Tensor, Tensor]:
        """Update tokens (N, T, 256) and image (N, H * W, 256), given their positional encodings; the shapes do not
        change.
        """
        if self.first:
            tokens = self.self_attn(tokens, tokens, tokens)
        else:
            placed = tokens + token_code
            tokens = tokens + self.self_attn(placed, placed, tokens)
        tokens = self.norm1(tokens)
        tokens = self.norm2(tokens + self.cross_attn_token_to_image(tokens + token_code, image + image_code, image))
        tokens = self.norm3(tokens + self.mlp(tokens))
        image = self.norm4(image + self.cross_attn_image_to_token(image + image_code, tokens + token_code, tokens))
        return tokens, image


class TwoWayTransformer(nn.Module):
    """The mask transformer of Segment Anything (Kirillov et al. 2023, appendix A)."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList(TwoWayBlock(first) for first in (True, False))
        self.final_attn_token_to_image = Attention(_WIDTH // 2)
        self.norm_final_attn = nn.LayerNorm(_WIDTH)

    def forward(self, tokens: Tensor, image: Tensor, image_code: Tensor) -> tuple[Tensor, Tensor]:
        """Return updated tokens (N, T, 256) and image (N, H * W, 256); the input tokens are also used as positional
        encodings.
        """
        token_code = tokens
        for layer in self.layers:
            tokens, image = layer(tokens, image, token_code, image_code)
        attended = self.final_attn_token_to_image(tokens + token_code, image + image_code, image)
        return self.norm_final_attn(tokens + attended), image


class _RandomFourier(nn.Module):
    """Positional encodings from a frequency matrix that is initialised randomly and learned."""

    def __init__(self) -> None:
        super().__init__()
        self.positional_encoding_gaussian_matrix = nn.Parameter(torch.randn(2, _WIDTH // 2))

    def forward(self, height: int, width: int) -> Tensor:
        """Return the positional encodings of a grid, (height * width, 256)."""
        matrix = self.positional_encoding_gaussian_matrix
        y = 2 * (torch.arange(height, device=matrix.device) + 0.5) / height - 1
        x = 2 * (torch.arange(width, device=matrix.device) + 0.5) / width - 1
        places = torch.stack((x.expand(height, -1), y[:, None].expand(-1, width)), dim=-1)
        angles = 2 * math.pi * (places.to(matrix.dtype) @ matrix)
        return torch.cat((angles.sin(), angles.cos()), dim=-1).flatten(0, 1)


class ContextAdapter(nn.Module):
    """The adapter, which updates the context by attention with the flow tokens."""

    def __init__(self) -> None:
        super().__init__()
        self.transformer = TwoWayTransformer()
        self.flow_init_token = nn.Embedding(2, _WIDTH)
        self.pe_layer = _RandomFourier()

    def forward(self, context: Tensor, task: Tensor) -> Tensor:
        """Map context (N, 256, H, W) and task token (1, 256) to (N, 256, H, W)."""
        n, _, height, width = context.shape
        tokens = torch.cat((self.flow_init_token.weight, task))[None].expand(n, -1, -1)
        _, image = self.transformer(tokens, context.flatten(2).transpose(1, 2), self.pe_layer(height, width))
        return image.transpose(1, 2).reshape(context.shape)

"""The fusion, task token and adapter that SAMFlow uses to add SAM's features to the flow network's context (Zhou et al.
2024).
"""

from __future__ import annotations

import math
from collections import OrderedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend

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
    """A two-way block: attention among the tokens, attention from tokens to image, an MLP, and attention from image to
    tokens, each followed by a residual and a norm.
    """

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

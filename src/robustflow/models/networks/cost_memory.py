"""FlowFormer's memory encoder: the cost map of every pixel is encoded as eight latent tokens (Huang et al. 2022,
3.2).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.allpairs import all_pairs, pixel_grid
from .blocks.attention import attend, linear_sine
from .blocks.twins import Twins
from .vertical_attention import VerticalAttention

_WIDTH, _TOKENS, _HEADS, _DEPTH = 128, 8, 8, 3


class CostPatchEmbedding(nn.Module):
    """Embed cost maps, with one token per 8 x 8 pixels."""

    def __init__(self) -> None:
        super().__init__()
        half = _WIDTH // 2
        self.proj = nn.Sequential(
            nn.Conv2d(1, half // 4, 6, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(half // 4, half // 2, 6, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(half // 2, half, 6, stride=2, padding=2),
        )
        self.ffn_with_coord = nn.Sequential(nn.Conv2d(_WIDTH, _WIDTH, 1), nn.ReLU(), nn.Conv2d(_WIDTH, _WIDTH, 1))
        self.norm = nn.LayerNorm(_WIDTH)

    def forward(self, maps: Tensor) -> Tensor:
        """Map (M, 1, H, W) to (M, ceil(H / 8) * ceil(W / 8), 128)."""
        x = self.proj(F.pad(maps, (0, -maps.shape[3] % 8, 0, -maps.shape[2] % 8)))
        centres = 8 * pixel_grid(x[:1]) + 4
        code = linear_sine(centres.permute(0, 2, 3, 1), _WIDTH // 2).permute(0, 3, 1, 2)
        x = self.ffn_with_coord(torch.cat((x, code.to(x.dtype).expand(len(x), -1, -1, -1)), dim=1))
        return self.norm(x.flatten(2).transpose(1, 2))


class LatentAttention(nn.Module):
    """Pre-norm attention from latent tokens to other tokens or to each other, followed by an MLP of the same width."""

    def __init__(self) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(_WIDTH)
        self.norm2 = nn.LayerNorm(_WIDTH)
        self.q = nn.Linear(_WIDTH, _WIDTH)
        self.k = nn.Linear(_WIDTH, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)
        # The third entry in the checkpoints' numbering is a dropout layer with rate 0.
        self.ffn = nn.Sequential(nn.Linear(_WIDTH, _WIDTH), nn.GELU(), nn.Identity(), nn.Linear(_WIDTH, _WIDTH))

    def forward(self, x: Tensor, others: Tensor | None = None) -> Tensor:
        """Update tokens (M, K, 128) by attention to `others` (M, L, 128), which are not normalised, or to each
        other.
        """
        query = self.norm1(x)
        target = query if others is None else others
        x = x + self.proj(attend(self.q(query), self.k(target), self.v(target), _HEADS))
        return x + self.ffn(self.norm2(x))


class CostPerceiver(nn.Module):
    """Encode cost maps as latent tokens."""

    def __init__(self) -> None:
        super().__init__()
        self.patch_embed = CostPatchEmbedding()
        self.latent_tokens = nn.Parameter(torch.randn(1, _TOKENS, _WIDTH))
        self.input_layer = LatentAttention()
        self.encoder_layers = nn.ModuleList(LatentAttention() for _ in range(_DEPTH))
        self.vertical_encoder_layers = nn.ModuleList(VerticalAttention() for _ in range(_DEPTH))

    def forward(self, cost_maps: Tensor, context: Tensor) -> Tensor:
        """Map cost maps (N * H * W, 1, H, W) and context (N, 256, H, W) to latent tokens (N * H * W, 8, 128)."""
        context = context.permute(0, 2, 3, 1)
        n, height, width, _ = context.shape
        latent = self.latent_tokens.expand(len(cost_maps), -1, -1)
        first = x = self.input_layer(latent, self.patch_embed(cost_maps))
        for among_tokens, among_pixels in zip(self.encoder_layers, self.vertical_encoder_layers, strict=True):
            x = among_tokens(x).reshape(n, height, width, _TOKENS, _WIDTH).permute(0, 3, 1, 2, 4)
            x = among_pixels(x.reshape(n * _TOKENS, height, width, _WIDTH), context)
            x = x.reshape(n, _TOKENS, height * width, _WIDTH).transpose(1, 2).reshape(-1, _TOKENS, _WIDTH)
        return first + x


class MemoryEncoder(nn.Module):
    """Compute the cost maps and the cost memory from two images."""

    def __init__(self) -> None:
        super().__init__()
        self.feat_encoder = Twins(large=True)
        self.channel_convertor = nn.Conv2d(256, 256, 1, bias=False)
        self.cost_perceiver_encoder = CostPerceiver()

    def forward(self, image1: Tensor, image2: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        """Encode images (N, 3, 8 * H, 8 * W) in -1..1 with context (N, 256, H, W)."""
        features = self.channel_convertor(self.feat_encoder(torch.cat((image1, image2))))
        features1, features2 = features.chunk(2)
        # The factor undoes the division by sqrt(256) exactly.
        cost_maps = all_pairs(features1 * features1.shape[1] ** 0.5, features2)
        return cost_maps, self.cost_perceiver_encoder(cost_maps, context)

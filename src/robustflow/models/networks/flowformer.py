"""FlowFormer (Huang et al. 2022): the encoder of the cost map of every pixel into eight latent tokens (3.2), and the
recurrent decoder, which queries this memory at the current target (3.3).
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks.attention import attend, context_attention, from_windows, gather, linear_sine, to_windows
from .blocks.correlation import all_pairs, pixel_grid, sample_window
from .blocks.raft import FlowHead, MotionEncoder, SepConvGRU, convex_upsample, mask_layers
from .blocks.twins import Twins, mlp

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


_QUERY, _MEMORY, _HEADS_MEMORY_DECODER, _RADIUS = 64, 128, 8, 4
_WINDOW = (2 * _RADIUS + 1) ** 2


class MemoryQuery(nn.Module):
    """Cross-attention of one query token per pixel to the tokens of its cost memory."""

    def __init__(self) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(_QUERY)
        self.norm2 = nn.LayerNorm(_QUERY)
        self.q = nn.Linear(_QUERY, _QUERY)
        self.k = nn.Linear(_MEMORY, _QUERY)
        self.v = nn.Linear(_MEMORY, _QUERY)
        self.proj = nn.Linear(2 * _QUERY, _QUERY)
        # The third entry in the checkpoints' numbering is a dropout layer with rate 0.
        self.ffn = nn.Sequential(nn.Linear(_QUERY, _QUERY), nn.GELU(), nn.Identity(), nn.Linear(_QUERY, _QUERY))

    def forward(self, token: Tensor, coordinates: Tensor, key: Tensor, value: Tensor) -> Tensor:
        """Map tokens (M, 1, 64), target coordinates (M, 1, 2) in pixels, and keys and values (M, 8,
        64) to (M, 1, 64).
        """
        query = self.q(self.norm1(token) + linear_sine(coordinates, _QUERY).to(token.dtype))
        attended = attend(query, key, value, _HEADS_MEMORY_DECODER)
        token = token + self.proj(torch.cat((attended, token), dim=-1))
        return token + self.ffn(self.norm2(token))


class _Aggregator(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.zeros(1))
        self.to_v = nn.Conv2d(128, 128, 1, bias=False)

    def forward(self, attention: Tensor, motion: Tensor) -> Tensor:
        return motion + self.gamma * gather(attention, self.to_v(motion))


class UpdateBlock(nn.Module):
    """GMA's update of the hidden state."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = MotionEncoder(_WINDOW + _QUERY)
        self.gru = SepConvGRU(128, 3 * 128)
        self.flow_head = FlowHead()
        self.mask = mask_layers()
        self.aggregator = _Aggregator()

    def forward(self, net: Tensor, inp: Tensor, costs: Tensor, flow: Tensor, attention: Tensor) -> Tensor:
        """Return the new hidden state (N, 128, H, W)."""
        motion = self.encoder(flow, costs)
        return self.gru(net, torch.cat((inp, motion, self.aggregator(attention, motion)), dim=1))


class _RelativePositions(nn.Module):
    """Position tables that are stored in the checkpoints but not used by the published model."""

    def __init__(self) -> None:
        super().__init__()
        self.rel_height = nn.Embedding(2 * 160 - 1, 128)
        self.rel_width = nn.Embedding(2 * 160 - 1, 128)
        index = torch.arange(160)
        self.register_buffer("rel_ind", index[None] - index[:, None] + 160 - 1)


class _ContextAttention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.to_qk = nn.Conv2d(128, 256, 1, bias=False)
        self.pos_emb = _RelativePositions()

    def forward(self, inp: Tensor) -> Tensor:
        return context_attention(self.to_qk(inp))


class MemoryDecoder(nn.Module):
    """Decode the flow recurrently from the cost memory."""

    def __init__(self) -> None:
        super().__init__()
        self.flow_token_encoder = nn.Sequential(nn.Conv2d(_WINDOW, _QUERY, 1), nn.GELU(), nn.Conv2d(_QUERY, _QUERY, 1))
        self.proj = nn.Conv2d(256, 256, 1)
        self.decoder_layer = nn.ModuleDict({"cross_attend": MemoryQuery()})
        self.update_block = UpdateBlock()
        self.att = _ContextAttention()

    def forward(
        self, cost_maps: Tensor, memory: Tensor, context: Tensor, iterations: int, every: bool
    ) -> tuple[list[Tensor], Tensor]:
        """Decode the flow from cost maps (N * H * W, 1, H, W), memory (N * H * W, 8, 128) and context (N, 256, H,
        W).
        """
        net, inp = self.proj(context).chunk(2, dim=1)
        net, inp = net.tanh(), inp.relu()
        attention = self.att(inp)
        query: Any = self.decoder_layer["cross_attend"]
        key, value = query.k(memory), query.v(memory)
        start = target = pixel_grid(context)
        n, _, height, width = context.shape
        flows = []
        for iteration in range(iterations):
            target = target.detach()
            pixels = target.permute(0, 2, 3, 1).reshape(-1, 2)
            local = sample_window(cost_maps, pixels, _RADIUS).reshape(n, height, width, _WINDOW).permute(0, 3, 1, 2)
            token = self.flow_token_encoder(local).permute(0, 2, 3, 1).reshape(-1, 1, _QUERY)
            token = query(token, pixels[:, None], key, value)
            token = token.reshape(n, height, width, _QUERY).permute(0, 3, 1, 2)
            costs = torch.cat((token, local), dim=1)
            net = self.update_block(net, inp, costs, target - start, attention)
            target = target + self.update_block.flow_head(net)
            if every or iteration == iterations - 1:
                # The factor balances the gradients of the mask and the flow.
                flows.append(convex_upsample(target - start, 0.25 * self.update_block.mask(net)))
        return flows, target - start


_CONTEXT, _PROJECTED = 256, 64


def _position_code(height: int, width: int, step: int, channels: int, like: Tensor) -> Tensor:
    """Return the positional encoding of every `step`-th pixel in a map, (height * width, channels)."""
    grid = pixel_grid(like.new_empty(1, 1, height, width)).flatten(2)[0].T
    return linear_sine(step * grid, channels).to(like.dtype)


class _BesideContext(nn.Module):
    """Base class of the two attention blocks, which appends the projected context to the tokens."""

    def __init__(self) -> None:
        super().__init__()
        self.context_proj = nn.Linear(_CONTEXT, _PROJECTED)

    def beside_context(self, x: Tensor, context: Tensor) -> Tensor:
        """Append the context (N, H, W, 256) to the tokens (N * K, H, W, C); the result is (N * K, H, W, C + 64)."""
        projected = self.context_proj(context).repeat_interleave(len(x) // len(context), dim=0)
        return torch.cat((x, projected), dim=-1)


class LocalContextAttention(_BesideContext):
    """Attention within windows of 7 x 7."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.k = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Map (N * K, H, W, C) and (N, H, W, 256) to (N * K, H, W, C)."""
        windows = to_windows(self.beside_context(x, context), 7)
        windows = windows + _position_code(7, 7, 1, windows.shape[-1], windows)
        mixed = attend(self.q(windows), self.k(windows), self.v(to_windows(x, 7)), _HEADS)
        return self.proj(from_windows(mixed, *x.shape[1:3]))


class ReducedContextAttention(_BesideContext):
    """Attention to the complete map, which is downsampled by a factor of four."""

    def __init__(self) -> None:
        super().__init__()
        self.q = nn.Linear(_WIDTH + _PROJECTED, _WIDTH)
        self.k = nn.Linear(_WIDTH, _WIDTH)
        self.v = nn.Linear(_WIDTH, _WIDTH)
        self.proj = nn.Linear(_WIDTH, _WIDTH)
        self.sr_key = nn.Conv2d(_WIDTH + _PROJECTED, _WIDTH, 4, stride=4)
        self.sr_value = nn.Conv2d(_WIDTH, _WIDTH, 4, stride=4)
        self.norm = nn.LayerNorm(_WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Map (N * K, H, W, C) and (N, H, W, 256) to (N * K, H, W, C)."""
        height, width = x.shape[1:3]
        seen = self.beside_context(x, context)
        query = self.q(seen.flatten(1, 2) + _position_code(height, width, 1, seen.shape[-1], seen))
        key, value = self._shrink(self.sr_key, seen), self._shrink(self.sr_value, x)
        key = self.k(key + _position_code(-(-height // 4), -(-width // 4), 4, _WIDTH, key))
        return self.proj(attend(query, key, self.v(value), _HEADS)).reshape(x.shape)

    def _shrink(self, convolution: nn.Conv2d, x: Tensor) -> Tensor:
        """Map (M, H, W, C), zero-padded at the bottom and on the right, to (M, ceil(H / 4) * ceil(W / 4), 128)."""
        x = F.pad(x.permute(0, 3, 1, 2), (0, -x.shape[2] % 4, 0, -x.shape[1] % 4))
        return self.norm(convolution(x).flatten(2).transpose(1, 2))


class _ContextBlock(nn.Module):
    def __init__(self, attention: nn.Module) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(_WIDTH)
        self.attn = attention
        self.norm2 = nn.LayerNorm(_WIDTH)
        self.mlp = mlp(_WIDTH)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        x = x + self.attn(self.norm1(x), context)
        return x + self.mlp(self.norm2(x))


class VerticalAttention(nn.Module):
    """A layer of local attention followed by downsampled global attention."""

    def __init__(self) -> None:
        super().__init__()
        self.local_block = _ContextBlock(LocalContextAttention())
        self.global_block = _ContextBlock(ReducedContextAttention())

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Update tokens (N * K, H, W, 128), where the K tokens of a pixel form K maps, given the context (N, H, W,
        256).
        """
        return self.global_block(self.local_block(x, context), context)

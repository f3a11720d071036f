"""FlowFormer's recurrent decoder, which queries the cost memory at the current target (Huang et al. 2022, 3.3)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from .blocks.allpairs import pixel_grid, sample_window
from .blocks.attention import attend, linear_sine
from .blocks.context_attention import context_attention, gather
from .blocks.convex_upsample import convex_upsample, mask_layers
from .blocks.gru import SepConvGRU
from .blocks.raft_update import FlowHead, MotionEncoder

_QUERY, _MEMORY, _HEADS, _RADIUS = 64, 128, 8, 4
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
        attended = attend(query, key, value, _HEADS)
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

"""The denoising decoder of FlowDiffuser (Luo et al., CVPR 2024): a recurrent update conditioned on the noise level."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .diffusion import time_code
from .sk_update import SkUpdate

_CODE = 256


class _TimedConv(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.zeros(1))
        self.conv1 = nn.Sequential(
            nn.GroupNorm(4, 128), nn.GELU(), nn.Conv2d(128, 128, 3, padding=1), nn.GroupNorm(4, 128)
        )
        self.conv2 = nn.Sequential(nn.GELU(), nn.Conv2d(128, 128, 3, padding=1))

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        return self.gamma * self.conv2(self.conv1(x) * (scale + 1) + shift)


class Denoiser(nn.Module):
    """A layer that conditions an `SkUpdate` on time."""

    def __init__(self) -> None:
        super().__init__()
        self.conv_ee = _TimedConv()
        # Entry 0 in the checkpoints' numbering is the time encoding, which has no weights.
        self.time_mlp = nn.Sequential(nn.Identity(), nn.Linear(_CODE, 512), nn.GELU(), nn.Linear(512, 512))
        self.block_time_mlp = nn.Sequential(nn.SiLU(), nn.Linear(512, 256))

    def forward(
        self,
        update: SkUpdate,
        net: Tensor,
        context: Tensor,
        correlation: Tensor,
        flow: Tensor,
        attention: Tensor,
        time: int,
    ) -> Tensor:
        """Return the new hidden state (N, 128, H, W)."""
        code = self.block_time_mlp(self.time_mlp(time_code(time, _CODE, net)))
        scale, shift = code[:, :, None, None].chunk(2, dim=1)
        motion = update.encoder(flow, correlation)
        gathered = self.conv_ee(update.aggregator(attention, motion), scale, shift)
        return update(net, context, motion, gathered) * (scale + 1) + shift

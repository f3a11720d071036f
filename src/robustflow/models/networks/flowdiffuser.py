"""FlowDiffuser (Luo et al., CVPR 2024): a recurrent decoder denoises Gaussian noise to a flow, which is then refined at
1/4 resolution. The schedule is cosine (Nichol and Dhariwal 2021), with deterministic sampling (DDIM, Song et al. 2021).
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...core.rng import Rng
from .blocks.correlation import CorrelationPyramid, WindowVolume, pixel_grid
from .blocks.raft import convex_upsample
from .blocks.twins import Twins
from .flowdiffuser_layers import MaskHead, PairTransformer, SkUpdate

STEPS = 1000


def cosine_betas() -> Tensor:
    """Return the noise variances, float64 (1000,), clipped to at most 0.999 (Nichol and Dhariwal 2021, equation 17)."""
    time = torch.linspace(0, STEPS, STEPS + 1, dtype=torch.float64) / STEPS
    signal = torch.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2
    return (1 - signal[1:] / signal[:-1]).clamp(0, 0.999)


def register_schedule(module: nn.Module) -> None:
    """Register the checkpoints' twelve float64 buffers on `module`; only `alphas_cumprod` is used for prediction."""
    betas = cosine_betas()
    signal = torch.cumprod(1 - betas, dim=0)
    before = torch.cat((signal.new_ones(1), signal[:-1]))
    variance = betas * (1 - before) / (1 - signal)
    buffers = {
        "betas": betas,
        "alphas_cumprod": signal,
        "alphas_cumprod_prev": before,
        "sqrt_alphas_cumprod": signal.sqrt(),
        "sqrt_one_minus_alphas_cumprod": (1 - signal).sqrt(),
        "log_one_minus_alphas_cumprod": (1 - signal).log(),
        "sqrt_recip_alphas_cumprod": (1 / signal).sqrt(),
        "sqrt_recipm1_alphas_cumprod": (1 / signal - 1).sqrt(),
        "posterior_variance": variance,
        "posterior_log_variance_clipped": variance.clamp(min=1e-20).log(),
        "posterior_mean_coef1": betas * before.sqrt() / (1 - signal),
        "posterior_mean_coef2": (1 - before) * (1 - betas).sqrt() / (1 - signal),
    }
    for name, values in buffers.items():
        module.register_buffer(name, values)


SAMPLING_TIMES = (999, 749, 499, 249)
"""The times at which the sampler denoises, from the noisiest to the cleanest."""


def initial_noise(seed: int, height: int, width: int) -> Tensor:
    """Return the sampler's initial noise: standard normal, float32 (1, 2, height, width), the same on every machine."""
    values = Rng.of("flowdiffuser", seed, height, width).normals(2 * height * width)
    return torch.from_numpy(values.astype(np.float32)).reshape(1, 2, height, width)


def renoise(noisy: Tensor, clean: Tensor, kept: Tensor, kept_next: Tensor) -> Tensor:
    """Return the sample at the next time, without adding noise (Song et al. 2021, equation 12, sigma 0)."""
    noise = (noisy - kept.sqrt() * clean) / (1 - kept).sqrt()
    return kept_next.sqrt() * clean + (1 - kept_next).sqrt() * noise


def time_code(time: float, channels: int, like: Tensor) -> Tensor:
    """Return the sinusoidal encoding of a time, (1, channels): sines, then cosines (Vaswani et al. 2017)."""
    half = channels // 2
    rates = torch.exp(torch.arange(half, device=like.device) * (-math.log(10000) / (half - 1)))
    return torch.cat(((time * rates).sin(), (time * rates).cos()))[None].to(like.dtype)


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


_ITERATIONS = 6
_REACH = 0.1
"""Displacement represented by a sample value of 1, as a fraction of the map's size."""


class FlowDiffuser(nn.Module):
    """The published model; the state-dict keys are the same as in the authors' checkpoints."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.seed = seed
        # Constants in the checkpoints: a placeholder, and the factor between the normalised flow and the sample.
        self.zero = nn.Parameter(torch.zeros(12), requires_grad=False)
        self.scale = nn.Parameter(torch.full((1,), 0.5), requires_grad=False)
        register_schedule(self)
        self.fnet = Twins(large=True)
        self.cnet = Twins(large=False)
        self.trans = PairTransformer()
        self.C_inp = nn.Conv2d(128, 128, 1)
        self.C_net = nn.Conv2d(128, 128, 1)
        self.update = SkUpdate()
        self.um8 = MaskHead(8)
        self.um4 = MaskHead(4)
        self.update_dfm = Denoiser()

    def encode(self, encoder: Twins, image: Tensor) -> tuple[Tensor, Tensor]:
        """Return the features at 1/8 and at 1/4 resolution; the second stage is applied twice with the same weights."""
        quarter = encoder.stage(0, image)
        return encoder.stage(1, quarter), encoder.stage(1, quarter, dense=True)

    def forward(self, image1: Tensor, image2: Tensor, noise: Tensor | None = None) -> Tensor:
        """Return the flow from image 1 to image 2, (N, 2, H, W) in pixels; arguments as for `flows`."""
        return self.flows(image1, image2, noise)[0][-1]

    def flows(self, image1: Tensor, image2: Tensor, noise: Tensor | None = None) -> tuple[list[Tensor], Tensor]:
        """Return the flow after each denoising step and after the refinement."""
        image1, image2 = 2 * image1 / 255 - 1, 2 * image2 / 255 - 1
        pyramid, features4, context8, context4 = self._encoded(image1, image2)
        if noise is None:
            noise = initial_noise(self.seed, *context8.shape[2:]).to(image1.device).expand(len(image1), -1, -1, -1)
        net, flow, flows = self._denoise(pyramid, context8, noise)
        net, fine = self._refined(features4, context4, net, flow)[-1]
        return [*flows, convex_upsample(fine, self.um4(net), factor=4)], fine

    def denoised_predictions(
        self, image1: Tensor, image2: Tensor, truth: Tensor, time: int, noise: Tensor
    ) -> list[Tensor]:
        """Compute the predictions for training: one denoising step from the noisy ground truth, and the refinement."""
        image1, image2 = 2 * image1 / 255 - 1, 2 * image2 / 255 - 1
        pyramid, features4, context8, context4 = self._encoded(image1, image2)
        inp, net, size = self.C_inp(context8), self.C_net(context8), _size(context8)
        attention = self.update.aggregator.attention(inp)
        start = pixel_grid(context8)
        small = F.interpolate(truth, size=context8.shape[2:], mode="bilinear", align_corners=True) / 8
        signal = self.alphas_cumprod[time]
        sample = signal.sqrt() * self.scale * small / size + (1 - signal).sqrt() * noise
        target = start + sample.clamp(-1, 1).to(start.dtype) * _REACH * size
        coarse = self._rounds(pyramid, inp, attention, net, target, time)
        net, target = coarse[-1]
        fine = self._refined(features4, context4, net, target - start)
        return [convex_upsample(moved - start, self.um8(state)) for state, moved in coarse] + [
            convex_upsample(flow, self.um4(state), factor=4) for state, flow in fine
        ]

    def _encoded(self, image1: Tensor, image2: Tensor) -> tuple[CorrelationPyramid, Tensor, Tensor, Tensor]:
        """Return the correlations at 1/8, the features at 1/4, and the context at 1/8 and 1/4, for images in -1..1."""
        features8, features4 = self.encode(self.fnet, torch.cat((image1, image2)))
        context8, context4 = self.encode(self.cnet, image1)
        features1, features2 = features8.chunk(2)
        return CorrelationPyramid(*self.trans(features1, features2)), features4, context8, context4

    def _denoise(
        self, pyramid: CorrelationPyramid, context: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor, list[Tensor]]:
        inp, net = self.C_inp(context), self.C_net(context)
        start = target = pixel_grid(context)
        attention = self.update.aggregator.attention(inp)
        size = _size(context)
        sample, flows = noise, list[Tensor]()
        for time, following in zip(SAMPLING_TIMES, (*SAMPLING_TIMES[1:], -1), strict=True):
            shift = sample.clamp(-1, 1).to(target.dtype) * _REACH * size
            target = target + (0.2 * shift if flows else shift)
            net, target = self._rounds(pyramid, inp, attention, net, target, time)[-1]
            flow = target - start
            flows.append(convex_upsample(flow, self.um8(net)))
            clean = (self.scale * flow / size).clamp(-0.5, 0.5)
            sample = renoise(sample, clean, self.alphas_cumprod[time], self.alphas_cumprod[following])
        return net, flow, flows

    def _rounds(
        self, pyramid: CorrelationPyramid, inp: Tensor, attention: Tensor, net: Tensor, target: Tensor, time: int
    ) -> list[tuple[Tensor, Tensor]]:
        """Return the state and the target after each iteration of a denoising step."""
        start, states = pixel_grid(inp), []
        for iteration in range(_ITERATIONS):
            target = target.detach()
            correlation = pyramid.lookup(target)
            moment = int(time - time / _ITERATIONS * iteration)
            net = self.update_dfm(self.update, net, inp, correlation, target - start, attention, moment)
            target = target + self.update.flow_head(net)
            states.append((net, target))
        return states

    def _refined(self, features: Tensor, context: Tensor, net: Tensor, flow: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Return the state and the flow at 1/4 resolution, in its pixels, after each iteration."""
        enlarge = {"size": context.shape[2:], "mode": "bilinear", "align_corners": True}
        flow, net = F.interpolate(2 * flow, **enlarge), F.interpolate(net, **enlarge)
        start = pixel_grid(context)
        target = start + flow
        features1, features2 = features.chunk(2)
        volume, states = WindowVolume(features1, features2, target), []
        for _ in range(_ITERATIONS):
            target = target.detach()
            motion = self.update.encoder(target - start, volume.lookup(target))
            net = self.update(net, context, motion, motion)
            target = target + self.update.flow_head(net)
            states.append((net, target - start))
        return states


def _size(context: Tensor) -> Tensor:
    """Return (W, H) of a map (N, C, H, W) as a tensor (2, 1, 1)."""
    return context.new_tensor((context.shape[3], context.shape[2]))[:, None, None]

"""The diffusion schedule of FlowDiffuser: cosine (Nichol and Dhariwal 2021), with deterministic sampling
(DDIM, Song et al. 2021).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from ...random.rng import Rng

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

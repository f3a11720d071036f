"""The diffusion schedule matches its definition, and the sampler's step preserves the expected quantities."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import math

import torch

from robustflow.models.networks.flowdiffuser import initial_noise, register_schedule, renoise

pytestmark = pytest.mark.torch


@pytest.fixture
def schedule():
    module = torch.nn.Module()
    register_schedule(module)
    return module


def test_the_schedule_is_nichol_and_dhariwals(schedule):
    """Compute equation 17 of the paper, and equations 6, 10 and 11 of Ho et al. 2020, in a float64 loop."""

    def f(step):
        return math.cos((step / 1000 + 0.008) / 1.008 * math.pi / 2) ** 2

    signal = 1.0
    for step in range(1000):
        beta = min(1 - f(step + 1) / f(step), 0.999)
        before, signal = signal, signal * (1 - beta)
        wanted = {
            "betas": beta,
            "alphas_cumprod": signal,
            "alphas_cumprod_prev": before,
            "sqrt_alphas_cumprod": math.sqrt(signal),
            "sqrt_one_minus_alphas_cumprod": math.sqrt(1 - signal),
            "log_one_minus_alphas_cumprod": math.log(1 - signal),
            "sqrt_recip_alphas_cumprod": math.sqrt(1 / signal),
            "sqrt_recipm1_alphas_cumprod": math.sqrt(1 / signal - 1),
            "posterior_variance": beta * (1 - before) / (1 - signal),
            "posterior_log_variance_clipped": math.log(max(beta * (1 - before) / (1 - signal), 1e-20)),
            "posterior_mean_coef1": beta * math.sqrt(before) / (1 - signal),
            "posterior_mean_coef2": (1 - before) * math.sqrt(1 - beta) / (1 - signal),
        }
        for name, value in wanted.items():
            found = getattr(schedule, name)
            assert found.dtype == torch.float64
            assert found[step].item() == pytest.approx(value, rel=1e-8, abs=1e-12), (name, step)


def test_a_step_keeps_the_noise_and_lowers_its_level(schedule):
    generator = torch.Generator().manual_seed(0)
    clean, noise = (torch.randn((1, 2, 3, 4), generator=generator, dtype=torch.float64) for _ in range(2))
    now, following = schedule.alphas_cumprod[749], schedule.alphas_cumprod[499]
    noisy = now.sqrt() * clean + (1 - now).sqrt() * noise
    found = renoise(noisy, clean, now, following)
    torch.testing.assert_close(found, following.sqrt() * clean + (1 - following).sqrt() * noise)


def test_the_noise_is_normal_and_named_by_seed_and_size():
    noise = initial_noise(3, 100, 120)
    assert noise.shape == (1, 2, 100, 120)
    # Four standard errors of the mean and the variance of 24 000 numbers.
    assert abs(noise.mean()) < 4 / 24000**0.5
    assert abs(noise.var() - 1) < 4 * (2 / 24000) ** 0.5
    assert not torch.equal(noise, initial_noise(4, 100, 120))

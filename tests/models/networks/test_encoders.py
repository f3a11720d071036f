"""What the parity packs do not cover: windows and positions of the image encoders, and the diffusion schedule."""

import math

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.core.errors import ModelError
from robustflow.models.networks.blocks.attention import attend
from robustflow.models.networks.flowdiffuser import initial_noise, register_schedule, renoise
from robustflow.models.networks.flowdiffuser_layers import PairTransformer, WindowBlock
from robustflow.models.networks.sam_encoders import Attention, SamSize, SamVit, WindowAttention, distance_index

from ...refusals import refusal

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("first_rows", [False, True])
def test_attention_adds_decomposed_relative_positions(first_rows):
    torch.manual_seed(0)
    height, width, grid, heads, channels = 3, 4, 5, 2, 8
    attention = Attention(channels, heads, grid, first_rows)
    with torch.no_grad():
        for table in (attention.rel_pos_h, attention.rel_pos_w):
            table.normal_()
        tokens = torch.randn(1, height * width, channels)
        found = attention(tokens, height, width)[0]
        query, key, value = attention.qkv(tokens)[0].double().chunk(3, dim=1)
        mixed = torch.zeros(height * width, channels, dtype=torch.float64)
        for head in range(heads):
            part = slice(4 * head, 4 * head + 4)
            for i in range(height * width):
                logits = torch.zeros(height * width, dtype=torch.float64)
                for j in range(height * width):
                    dy, dx = i // width - j // width, i % width - j % width
                    # Distance 0 is at the centre of the table, or of its first 2 n - 1 rows.
                    row = attention.rel_pos_h[dy + (height - 1 if first_rows else grid - 1)].double()
                    column = attention.rel_pos_w[dx + (width - 1 if first_rows else grid - 1)].double()
                    q = query[i, part]
                    logits[j] = (q * key[j, part]).sum() / 2 + (q * row).sum() + (q * column).sum()
                mixed[i, part] = logits.softmax(dim=0) @ value[:, part]
        wanted = mixed @ attention.proj.weight.double().T + attention.proj.bias.double()
    torch.testing.assert_close(found.double(), wanted, atol=1e-6, rtol=1e-5)


def test_beyond_1024_pixels_there_are_no_positions():
    net = SamVit(SamSize(width=8, depth=1, heads=2, global_blocks=(0,)))
    with torch.no_grad():
        assert net(torch.zeros(1, 3, 32, 1024)).shape == (1, 256, 2, 64)
        refusal(lambda: net(torch.zeros(1, 3, 32, 1040)), ModelError, "32x1040")


@pytest.mark.parametrize("size", [7, 14])
def test_biases_are_numbered_in_the_order_their_distances_appear(size):
    pixels = [(y, x) for y in range(size) for x in range(size)]
    numbers: dict[tuple[int, int], int] = {}
    wanted = [
        [numbers.setdefault((abs(y1 - y2), abs(x1 - x2)), len(numbers)) for y2, x2 in pixels] for y1, x1 in pixels
    ]
    assert distance_index(size).tolist() == wanted


def test_heads_hold_query_key_and_value_side_by_side():
    torch.manual_seed(0)
    attention = WindowAttention(6, heads=2, window=2)
    with torch.no_grad():
        attention.attention_biases.normal_()
        x = torch.randn(1, 2, 3, 6)
        found = attention(x)
        padded = torch.zeros(1, 2, 4, 6)
        padded[:, :, :3] = x
        for left in (0, 2):
            tokens = attention.norm(padded[0, :, left : left + 2].reshape(4, 6))
            qkv = attention.qkv(tokens).double()
            mixed = []
            for head in range(2):
                query, key, value = qkv[:, 9 * head : 9 * head + 9].split(3, dim=1)
                logits = torch.zeros(4, 4, dtype=torch.float64)
                for i in range(4):
                    for j in range(4):
                        number = 2 * abs(i // 2 - j // 2) + abs(i % 2 - j % 2)
                        logits[i, j] = (query[i] * key[j]).sum() / 3**0.5 + attention.attention_biases[head, number]
                mixed.append(logits.softmax(dim=1) @ value)
            wanted = torch.cat(mixed, dim=1) @ attention.proj.weight.double().T + attention.proj.bias.double()
            part = found[0, :, left : left + 2]
            torch.testing.assert_close(part.double(), wanted.view(2, 2, 6)[:, : part.shape[1]], atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("shift", [0, 4])
def test_pixels_meet_inside_a_window_that_does_not_wrap(shift):
    torch.manual_seed(0)
    block = WindowBlock(shift)
    height, width = 16, 24
    labels = torch.zeros(height, width, dtype=torch.long)
    labels[:5] = labels[:, :1] = labels[:, 22:] = 1
    x = torch.randn(2, height, width, 256)
    with torch.no_grad():
        found = block(x, labels)
        y, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        windows = torch.stack(((y - shift) // 8, (column - shift) // 8, labels), dim=-1).reshape(-1, 3)
        together = (windows[:, None] == windows).all(dim=-1)
        normed = block.layer_norm1(x).flatten(1, 2)
        attention = block.self_attn
        bias = torch.zeros(together.shape).masked_fill(~together, float("-inf"))
        mixed = attend(attention.q(normed), attention.k(normed), attention.v(normed), bias=bias)
        wanted = x.flatten(1, 2) + attention.proj(mixed)
        wanted = wanted + block.mlp(block.layer_norm2(wanted))
    torch.testing.assert_close(found.flatten(1, 2), wanted, atol=1e-5, rtol=1e-5)


def test_pairs_of_a_batch_are_encoded_independently():
    torch.manual_seed(0)
    net = PairTransformer().eval()
    first, second = torch.randn(2, 3, 256, 11, 13).unbind()
    with torch.no_grad():
        together = net(first, second)
        alone = net(first[1:2], second[1:2])
    for found, wanted in zip(together, alone, strict=True):
        assert found.shape == first.shape
        torch.testing.assert_close(found[1:2], wanted, atol=1e-4, rtol=1e-4)


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

"""What a gated unit does when its gates are held open or shut."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.models.networks.blocks.gru import SepConvGRU

pytestmark = pytest.mark.torch


@pytest.fixture
def unit():
    torch.manual_seed(0)
    return SepConvGRU(hidden=6, inputs=4).eval()


def step(unit):
    generator = torch.Generator().manual_seed(1)
    state, inputs = torch.randn(1, 6, 5, 7, generator=generator), torch.randn(1, 4, 5, 7, generator=generator)
    with torch.no_grad():
        return state, inputs, unit(state, inputs)


def set_gate(unit, gate, bias):
    for step_number in (1, 2):
        conv = getattr(unit, f"conv{gate}{step_number}")
        torch.nn.init.zeros_(conv.weight)
        torch.nn.init.constant_(conv.bias, bias)


def test_a_shut_update_gate_keeps_the_state(unit):
    set_gate(unit, "z", -200.0)
    state, _, found = step(unit)
    assert torch.equal(found, state)


def test_an_open_update_gate_and_a_shut_reset_gate_forget_the_state(unit):
    set_gate(unit, "z", 200.0)
    set_gate(unit, "r", -200.0)
    _, inputs, found = step(unit)
    expected = torch.tanh(unit.convq2(torch.cat((torch.zeros(1, 6, 5, 7), inputs), dim=1)))
    torch.testing.assert_close(found, expected)


def test_rows_come_before_columns(unit):
    kernels = {name: tuple(conv.kernel_size) for name, conv in unit.named_children()}
    assert list(kernels) == ["convz1", "convr1", "convq1", "convz2", "convr2", "convq2"]
    assert [kernels["convq1"], kernels["convq2"]] == [(1, 5), (5, 1)]

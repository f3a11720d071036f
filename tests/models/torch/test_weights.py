"""Weights that do not match a network, or must not be loaded into one."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

from robustflow.errors import ModelError

from .small_net import Net, load, net_state, one_line

pytestmark = pytest.mark.torch


@pytest.fixture
def state():
    return net_state()


def test_names_that_do_not_fit_are_told_apart(tmp_path, state):
    changed = dict(state)
    changed["head.weight"] = changed.pop("first.weight")
    changed["first.bias"] = torch.zeros(5)
    torch.save(changed, tmp_path / "weights.pth")
    net = Net()
    before = {key: value.clone() for key, value in net.state_dict().items()}
    with pytest.raises(ModelError) as error:
        load(tmp_path / "weights.pth", net)
    text = one_line(error)
    assert "not a checkpoint of small (7 entries)" in text
    assert "1 missing (first.weight)" in text
    assert "1 unexpected (head.weight)" in text
    assert "1 with a different shape (first.bias 5 instead of 4)" in text
    assert all(torch.equal(value, before[key]) for key, value in net.state_dict().items())


def test_many_differences_are_counted_not_listed(tmp_path):
    torch.save({f"layer{i}.weight": torch.zeros(1) for i in range(500)}, tmp_path / "weights.pth")
    with pytest.raises(
        ModelError, match=r"500 unexpected \(layer0\.weight, layer1\.weight, layer2\.weight, and 497 more\)"
    ) as error:
        load(tmp_path / "weights.pth")
    assert len(one_line(error)) < 500 + len(str(tmp_path))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floating_point_weights_are_cast_and_told(tmp_path, state, dtype):
    other = {key: value.to(dtype) if value.is_floating_point() else value for key, value in state.items()}
    torch.save(other, tmp_path / "weights.pth")
    net, _, cast = load(tmp_path / "weights.pth")
    assert cast == str(dtype).removeprefix("torch.")
    assert net.first.weight.dtype == torch.float32
    assert torch.equal(net.first.weight, other["first.weight"].float())


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_values_that_are_not_finite_are_refused(tmp_path, state, bad):
    state["first.weight"][1, 2, 0, 1] = bad
    torch.save(state, tmp_path / "weights.pth")
    with pytest.raises(ModelError, match=r"1 of 108 values of 'first\.weight' are NaN or infinite") as error:
        load(tmp_path / "weights.pth")
    one_line(error)


def test_a_value_too_large_for_float32_is_refused(tmp_path, state):
    wide = {key: value.double() if value.is_floating_point() else value for key, value in state.items()}
    wide["first.bias"][0] = 1e300
    torch.save(wide, tmp_path / "weights.pth")
    with pytest.raises(ModelError, match=r"1 of 4 values of 'first\.bias'"):
        load(tmp_path / "weights.pth")


@pytest.mark.parametrize(
    ("value", "holds"),
    [
        (torch.zeros(4, dtype=torch.int32), "int32"),
        (torch.zeros(4, dtype=torch.complex64), "complex64"),
        (torch.zeros(4).to_sparse(), "sparse"),
        (torch.zeros(4, device="meta"), "float32 without values"),
    ],
    ids=["integers", "complex", "sparse", "meta"],
)
def test_values_of_another_kind_are_refused(tmp_path, state, value, holds):
    torch.save({**state, "first.bias": value}, tmp_path / "weights.pth")
    with pytest.raises(ModelError, match=rf"'first\.bias' contains {holds}.*, expected float32;") as error:
        load(tmp_path / "weights.pth")
    one_line(error)


def test_a_huge_tensor_of_one_stored_value_is_refused_by_its_shape(tmp_path, state):
    state["first.bias"] = torch.zeros(1).expand(1 << 40)
    torch.save(state, tmp_path / "weights.pth")
    assert (tmp_path / "weights.pth").stat().st_size < 100_000
    with pytest.raises(ModelError, match="1099511627776 instead of 4"):
        load(tmp_path / "weights.pth")

"""For every network that is batched on a GPU, the flow of a pair does not depend on the rest of the batch.

On the CPU, `predict_batch` processes the pairs one by one; these tests therefore call `run`, the single network call
that is made on a GPU.
"""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.func import functional_call

from robustflow import load_model
from robustflow.core.plugins import parameters_of
from robustflow.models.networks.loaders import NETWORKS
from robustflow.models.ptlflow.loaders import BATCHED, CLIPS
from robustflow.models.registered import MODELS

from ..parity.weight_rule import fill_by_rule
from .textures import textured_pair

pytestmark = pytest.mark.torch

NAMES = (*BATCHED, *NETWORKS, "raft_large", "raft_small", "tiny", "tiny_no_weather", "tiny_all")
PAIR_BY_PAIR = {"flowformer", "onnx", "farneback", "dis", "dis_rgb", "precomputed", *CLIPS}
"""Registered models that are not networks, or that process one pair at a time."""
LARGE = ("samflow_b", "samflow_h")
SIZE, SMALLER = (125, 187), (61, 93)
WITHOUT_RAFTS_LIMIT = ("flowformer_pp", *NETWORKS)
"""Networks that also return finite values for smaller frames."""
PYRAMIDS = ("arflow", "upflow")
"""Networks whose flow hardly depends on the frames if the weights are smaller; see the README of the parity packs."""


def network(name):
    """A model with weights from the parity packs' rule; with PyTorch's random weights, most layers hardly matter."""
    if name in (*BATCHED, "flowformer"):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    if name.startswith("tiny"):
        return load_model(name, device="cpu", runtime="torch")
    small = {"iterations": 2, "tile": "none", "size": "native"}
    options = {key: value for key, value in small.items() if key in parameters_of(MODELS.get(name))}
    model = load_model(name, checkpoint="random", device="cpu", **options)
    fill_by_rule(model.net, 2**0.5 if name in PYRAMIDS else 0.8)
    return model


def batch(*pairs):
    return [first for first, _ in pairs], [second for _, second in pairs]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LARGE else name for name in NAMES]
)
def test_pairs_of_a_batch_do_not_affect_each_other(name):
    model = network(name)
    size = SMALLER if name in WITHOUT_RAFTS_LIMIT else SIZE
    a, b, c = (textured_pair(*size, seed) for seed in range(3))
    together, exchanged = model.run(*batch(a, b)), model.run(*batch(a, c))
    np.testing.assert_array_equal(together[0], exchanged[0])
    alone = [model.run(*batch(pair))[0] for pair in (a, b)]
    scale = max(1.0, float(np.abs(alone[0]).max()))
    assert np.abs(alone[0] - alone[1]).mean() > 1e-3 * scale, "the flow does not depend on the frames"
    for flow, expected in zip(together, alone, strict=True):
        assert np.abs(flow - expected).max() <= 1e-4 * scale  # in a different batch, sums are rounded differently


def test_pairs_of_flowformer_are_predicted_one_by_one():
    model = network("flowformer")
    a, b, c = (textured_pair(*SMALLER, seed) for seed in range(3))
    one_by_one, model.net.batched = model.run(*batch(a, b)), True
    together, exchanged = model.run(*batch(a, b)), model.run(*batch(a, c))
    assert np.abs(together[0] - exchanged[0]).max() > 1e-3
    assert np.abs(together[0] - one_by_one[0]).max() > 1e-3
    for flow, pair in zip(one_by_one, (a, b), strict=True):
        np.testing.assert_array_equal(flow, model.predict(*pair))


def test_pairs_of_flowformer_pp_do_not_affect_each_other_in_training():
    net = network("flowformer_pp").net.train()
    pairs = np.stack([np.stack(textured_pair(64, 72, seed)) for seed in range(3)])
    frames = torch.from_numpy(pairs).permute(1, 0, 4, 2, 3).float()
    with torch.no_grad():
        together, exchanged = (net.predictions(*frames[:, which]) for which in ([0, 1], [0, 2]))
    for flow, other in zip(together, exchanged, strict=True):
        assert torch.equal(flow[0], other[0])
        assert not torch.equal(flow[1], other[1])


@pytest.mark.parametrize("name", [*(name for name in NETWORKS if name not in LARGE), "tiny"])
def test_a_network_makes_no_tensor_on_another_device_than_its_images(name):
    """Tensors on a GPU device but without values; PyTorch refuses to combine them with CPU tensors."""
    net = network(name).net
    with FakeTensorMode(allow_non_fake_inputs=True), torch.backends.cudnn.flags(enabled=False), torch.no_grad():
        state = {**dict(net.named_parameters()), **dict(net.named_buffers())}
        state = {key: torch.empty(value.shape, dtype=value.dtype, device="cuda") for key, value in state.items()}
        flow = functional_call(net, state, tuple(torch.empty(2, 2, 3, 128, 192, device="cuda")))
    assert (flow.device.type, tuple(flow.shape)) == ("cuda", (2, 2, 128, 192))


def test_every_registered_network_is_compared():
    assert set(MODELS) - PAIR_BY_PAIR == set(NAMES)

"""A user's networks: training, seeding, and losses that the networks define themselves."""

from __future__ import annotations

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

import robustflow as rf  # noqa: E402
from robustflow.core.errors import ModelError, UsageError  # noqa: E402
from robustflow.training.networks import load_network  # noqa: E402
from robustflow.training.recipe import load_recipe, recipes_of  # noqa: E402
from robustflow.training.request import Validation  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402

from ..refusals import refusal  # noqa: E402
from .progress import lines, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


OWN_NETWORK = """
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.corrector = nn.Conv2d(6, 8, 3, padding=1)  # also the prefix of BrightFlow's corrector
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(8, 2, 3, padding=1)

    def forward(self, image1, image2):
        import torch

        features = self.norm(self.corrector(torch.cat([image1, image2], dim=1)))
        flow = self.last(features)
        return [flow / 2, flow]
"""


OPTIONS = (("scaling", "-1-1"), ("order", "rgb"), ("layout", "pair"))


def test_own_network_is_trained_and_its_checkpoint_loads(request_for, tmp_path, monkeypatch):
    (tmp_path / "own_net_for_test.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    request = request_for(options=OPTIONS, frozen_norms="none")
    own = replace(request, recipe=request.recipe.changed(method="own_net_for_test:Net"))
    path = run_training(own)
    state = weights(path)
    assert state["norm.num_batches_tracked"] == own.recipe.updates == len(lines(own.output))  # in training mode
    model = rf.load_model("own_net_for_test:Net", checkpoint=str(path), device="cpu", **dict(OPTIONS))
    assert torch.equal(model.net.module.last.weight, state["last.weight"])
    run_training(replace(own, resume=True))
    assert all(torch.equal(value, state[name]) for name, value in weights(path).items())


SEVERAL_OUTPUTS = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.last = nn.Conv2d(6, 2, 3, padding=1)

    def forward(self, image1, image2):
        there, back = self.last(torch.cat([image1, image2], 1)), self.last(torch.cat([image2, image1], 1))
        return RETURNED
"""


@pytest.mark.parametrize(
    ("returned", "output", "count"),
    [
        ('{"back": back, "flows": [there / 2, there]}', None, 2),
        ('{"flow": there, "back": back}', "flow", 1),
        ("(there, back)", 0, 1),
        ("([there / 2, there], there[:, :1])", 0, 2),
        ("(there / 2, there)", None, 2),
    ],
)
def test_training_uses_the_output_that_a_prediction_uses(tmp_path, monkeypatch, returned, output, count):
    name = f"several_outputs_{len(returned)}"
    (tmp_path / f"{name}.py").write_text(SEVERAL_OUTPUTS.replace("RETURNED", returned))
    monkeypatch.syspath_prepend(tmp_path)
    options = dict(OPTIONS) | ({} if output is None else {"output": output})
    model, network = load_network(
        load_recipe("raft_small", "chairs").changed(method=f"{name}:Net"), "random", "cpu", options
    )
    images = [255 * torch.rand(2, 3, 128, 128) for _ in range(2)]
    flows = network(*images)
    assert len(flows) == count
    assert torch.allclose(flows[-1], model.net(*(image / 127.5 - 1 for image in images)), atol=1e-4)


FROZEN = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(3, 8, 3, padding=1).requires_grad_(False)
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(16, 2, 3, padding=1)

    def forward(self, image1, image2):
        features = self.norm(self.first(torch.cat([image1, image2])))
        return self.last(torch.cat(features.chunk(2), dim=1))

class Norms(nn.Module):
    def __init__(self):
        super().__init__()
        self.norms = nn.ModuleList(kind(2) for kind in (nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm))

    def forward(self, image1, image2):
        return (image1 - image2)[:, :2]
"""


def test_a_users_network_keeps_what_it_freezes_and_its_own_batchnorm(tmp_path, monkeypatch):
    (tmp_path / "frozen_net_for_test.py").write_text(FROZEN)
    monkeypatch.syspath_prepend(tmp_path)
    recipe = load_recipe("raft", "chairs").changed(method="frozen_net_for_test:Net")
    assert recipe.devices == 2  # each part of a batch would be the features of one of the frames
    model, network = load_network(recipe, "random", "cpu", dict(OPTIONS))
    learning = {name for name, value in network.named_parameters() if value.requires_grad}
    assert learning == {f"net.module.{name}" for name in ("norm.weight", "norm.bias", "last.weight", "last.bias")}
    images = [255 * torch.rand(4, 3, 128, 128) for _ in range(2)]
    network.train()(*images)
    with torch.no_grad():
        features = model.net.module.first(torch.cat(images) / 127.5 - 1)
    assert torch.allclose(model.net.module.norm.running_mean, 0.1 * features.mean((0, 2, 3)), atol=1e-5)


@pytest.mark.parametrize("frozen", ["batchnorm", "all"])
def test_frozen_norms_freeze_batchnorm_of_every_dimension(tmp_path, monkeypatch, frozen):
    (tmp_path / f"norms_for_{frozen}.py").write_text(FROZEN)
    monkeypatch.syspath_prepend(tmp_path)
    recipe = load_recipe("raft", "things").changed(method=f"norms_for_{frozen}:Norms", frozen_norms=frozen)
    model, network = load_network(recipe, "random", "cpu", dict(OPTIONS))
    network.train()
    assert [norm.training for norm in model.net.module.norms] == [False] * 3


FAILING = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.last = nn.Conv2d(6, 2, 3, padding=1)

    def forward(self, image1, image2):
        return self.last(torch.cat([image1, image2], 1)) * (1 if self.training else float("nan"))

class Cut(Net):
    def forward(self, image1, image2):
        return super().forward(image1, image2).detach()

class Full(Net):
    def forward(self, image1, image2):
        if self.training:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return super().forward(image1, image2)

class NoEntry(Net):
    def loss(self, batch):
        return batch["disparity"]

class Text(Net):
    def loss(self, batch):
        return self(batch["image1"], batch["image2"]).mean(), {"remark": "fine"}

class Complex(Net):
    def loss(self, batch):
        return self(batch["image1"], batch["image2"]).mean(), {"spectrum": 1j}

class Epoch(Net):
    def get_extra_state(self):
        return {"epoch": 3}

    def set_extra_state(self, state):
        pass
"""


@pytest.mark.parametrize(
    ("kind", "error", "culprit"),
    [
        ("Net", ModelError, "--validate"),
        ("Cut", ModelError, "loss"),
        ("Full", ModelError, "Full"),
        ("NoEntry", ModelError, "failing_nets:NoEntry"),
        ("Text", UsageError, "loss(batch)"),
        ("Complex", UsageError, "loss(batch)"),
        ("Epoch", UsageError, "Epoch"),
    ],
)
def test_a_network_that_cannot_be_trained_is_named_in_a_sentence(
    request_for, chairs, tmp_path, monkeypatch, kind, error, culprit
):
    (tmp_path / "failing_nets.py").write_text(FAILING)
    monkeypatch.syspath_prepend(tmp_path)
    validation = Validation("flyingchairs", chairs / "FlyingChairs_release", every=1, limit=1)
    request = request_for(options=OPTIONS, steps=1, validation=validation)
    failing = replace(request, recipe=request.recipe.changed(method=f"failing_nets:{kind}"))
    refusal(lambda: run_training(failing), error, culprit)


@pytest.mark.parametrize("kind", ["raft_small", "own_net_for_seed:Net", "arflow", "upflow", "brightflow"])
def test_seed_determines_every_random_weight(tmp_path, monkeypatch, kind):
    (tmp_path / "own_net_for_seed.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    own = ":" in kind
    method = "raft_small" if own else kind
    recipe = load_recipe(method, next(iter(recipes_of(method)))).changed(method=kind)
    options = dict(OPTIONS) if own else {}
    first, again, other = (load_network(recipe, "random", "cpu", options, seed)[1].weights() for seed in (3, 3, 4))
    drawn = [name for name, value in first.items() if value.ndim == 4]
    assert len(drawn) > (1 if own else 10)
    assert [name for name in first if not torch.equal(first[name], again[name])] == []
    assert [name for name in drawn if torch.equal(first[name], other[name])] == []


@pytest.mark.parametrize("method", ["arflow", "upflow"])
def test_random_convolutions_of_methods_without_labels_are_he_normal_with_zero_biases(method):
    _, network = load_network(load_recipe(method, "unsupervised"), "random")
    layers = [layer for layer in network.modules() if isinstance(layer, torch.nn.Conv2d)]
    drawn = torch.cat([(layer.weight * (layer.weight[0].numel() / 2) ** 0.5).flatten() for layer in layers])
    assert drawn.std().item() == pytest.approx(1, rel=0.01)
    assert (drawn.abs() < 1).float().mean().item() == pytest.approx(0.6827, rel=0.01)  # a normal distribution's share
    assert not any(layer.bias.any() for layer in layers if layer.bias is not None)


def test_random_weights_of_a_training_are_those_of_a_run():
    plain = rf.load_model("raft_small", checkpoint="random", device="cpu").net.model.state_dict()
    _, network = load_network(load_recipe("raft_small", "chairs"), "random")
    assert all(torch.equal(plain[key], value) for key, value in network.weights().items())


OWN_LOSS = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.last = nn.Conv2d(6, 2, 3, padding=1)

    def forward(self, image1, image2):
        return self.last(torch.cat([image1, image2], dim=1))

    def loss(self, batch):
        assert set(batch) == {"image1", "image2", "flow", "valid"}
        assert batch["image1"].min() >= -1 and batch["image1"].max() <= 1
        flow = self(batch["image1"], batch["image2"])
        error = (flow - batch["flow"]).square().sum(1)[batch["valid"] > 0].mean()
        return RETURNED
"""


def test_network_with_a_custom_loss_is_trained_with_it(request_for, tmp_path, monkeypatch):
    (tmp_path / "own_loss_for_test.py").write_text(
        OWN_LOSS.replace("RETURNED", 'error, {"squared": error, "update": 7, "empty": float("nan")}')
    )
    (tmp_path / "bad_loss_for_test.py").write_text(OWN_LOSS.replace("RETURNED", "[error]"))
    monkeypatch.syspath_prepend(tmp_path)
    request = request_for(options=OPTIONS)
    own = replace(request, recipe=request.recipe.changed(method="own_loss_for_test:Net"))
    run_training(own)
    assert all(entry["loss"] == pytest.approx(entry["squared"]) for entry in lines(own.output))
    assert [(entry["update"], entry["empty"]) for entry in lines(own.output)] == [(0, None), (1, None)]  # strict JSON
    _, first = load_network(own.recipe, "random", "cpu", dict(OPTIONS))
    assert not torch.equal(first.weights()["last.weight"], weights(own.output / "last.pth")["last.weight"])
    bad = replace(own, recipe=own.recipe.changed(method="bad_loss_for_test:Net"), output=tmp_path / "bad")
    refusal(lambda: run_training(bad), UsageError, "loss(batch)")
    odd = replace(own, recipe=own.recipe.changed(crop=(124, 140)), output=tmp_path / "odd")
    refusal(lambda: run_training(odd), UsageError, "--crop")

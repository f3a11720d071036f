"""A user's networks: training, seeding, and losses that the networks define themselves."""

from __future__ import annotations

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")
pytest.importorskip("torchvision", reason="needs the torch extra")

from robustflow.errors import UsageError  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402

from .progress import lines, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]


OWN_NETWORK = """
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(6, 8, 3, padding=1)
        self.norm = nn.BatchNorm2d(8)
        self.last = nn.Conv2d(8, 2, 3, padding=1)

    def forward(self, image1, image2):
        import torch

        features = self.norm(self.first(torch.cat([image1, image2], dim=1)))
        flow = self.last(features)
        return [flow / 2, flow]
"""


def test_a_network_of_ones_own(request_for, tmp_path, monkeypatch):
    import robustflow as rf

    (tmp_path / "own_net_for_test.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    options = (("scaling", "-1-1"), ("order", "rgb"), ("layout", "pair"))
    request = request_for(options=options, frozen_norms="none")
    own = replace(request, recipe=request.recipe.changed(method="own_net_for_test:Net"))
    path = run_training(own)
    state = weights(path)
    assert state["norm.num_batches_tracked"] == own.recipe.updates  # in training mode
    assert len(lines(own.output)) == own.recipe.updates
    model = rf.load_model("own_net_for_test:Net", checkpoint=str(path), device="cpu", **dict(options))
    assert torch.equal(model.net.module.last.weight, state["last.weight"])


@pytest.mark.parametrize("kind", ["raft_small", "own_net_for_seed:Net"])
def test_the_seed_is_that_of_the_first_weights_too(request_for, tmp_path, monkeypatch, kind):
    from robustflow.training.networks import load_network

    (tmp_path / "own_net_for_seed.py").write_text(OWN_NETWORK)
    monkeypatch.syspath_prepend(tmp_path)
    recipe = request_for().recipe.changed(method=kind)
    options = {"scaling": "-1-1", "order": "rgb", "layout": "pair"} if ":" in kind else {}
    first, again, other = (load_network(recipe, "random", "cpu", options, seed)[1].weights() for seed in (3, 3, 4))
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert any(not torch.equal(first[key], other[key]) for key in first)
    if ":" not in kind:
        import robustflow as rf

        plain = rf.load_model(kind, checkpoint="random", device="cpu").net.model.state_dict()
        assert all(torch.equal(plain[key], value) for key, value in load_network(recipe, "random")[1].weights().items())


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


def test_a_network_that_says_its_loss_itself(request_for, tmp_path, monkeypatch):
    (tmp_path / "own_loss_for_test.py").write_text(OWN_LOSS.replace("RETURNED", 'error, {"squared": error}'))
    (tmp_path / "bad_loss_for_test.py").write_text(OWN_LOSS.replace("RETURNED", "[error]"))
    monkeypatch.syspath_prepend(tmp_path)
    options = (("scaling", "-1-1"), ("order", "rgb"), ("layout", "pair"))
    request = request_for(options=options, steps=2)
    own = replace(request, recipe=request.recipe.changed(method="own_loss_for_test:Net"))
    run_training(own)
    entries = lines(own.output)
    assert all(entry["loss"] == pytest.approx(entry["squared"]) for entry in entries)
    from robustflow.training.networks import load_network

    _, first = load_network(own.recipe, "random", "cpu", dict(options))
    assert not torch.equal(first.weights()["last.weight"], weights(own.output / "last.pth")["last.weight"])
    bad = replace(own, recipe=own.recipe.changed(method="bad_loss_for_test:Net"), output=tmp_path / "bad")
    with pytest.raises(UsageError, match=r"method loss\(batch\) returned list; return a scalar tensor"):
        run_training(bad)
    odd = replace(own, recipe=own.recipe.changed(crop=(124, 140)), output=tmp_path / "odd")
    with pytest.raises(UsageError, match=r"would be padded to 128x144; use --crop 128x144"):
        run_training(odd)

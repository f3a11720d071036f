"""A user's PyTorch module: its input layout, outputs and weights, and the format that is declared or the default."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch import nn

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelRef
from robustflow.models.objects import as_model

from ...refusals import refusal
from ..textures import channel_flow, noise_pair, textured_pair

pytestmark = pytest.mark.torch
SOURCE = """
import torch

class Net(torch.nn.Module):
    def __init__(self, gain=1.0):
        super().__init__()
        self.gain = torch.nn.Parameter(torch.tensor(gain))
    def forward(self, image1, image2):
        return image1[:, :2] * self.gain

def factory(gain=2.0):
    return Net(gain)

net = Net(3.0)

class Broken(Net):
    def forward(self, image1, image2):
        return image1.no_such_thing
"""


class Channels(nn.Module):
    """Return the first channel of the first image as u and the last channel of the second image as v."""

    def __init__(self, layout="pair", returns=lambda flow: flow, factor=1):
        super().__init__()
        self.layout, self.returns = layout, returns
        self.factor = nn.Parameter(torch.full((1,), float(factor)))
        self.norm = nn.BatchNorm2d(2)  # only its mode matters; its contents are not used

    def forward(self, *images):
        if self.layout == "images":
            images = (images[0]["images"],)
        if self.layout in ("images", "stacked"):
            images = images[0][:, 0], images[0][:, 1]
        elif self.layout == "concatenated":
            images = images[0][:, :3], images[0][:, 3:]
        first, second = images
        return self.returns(torch.cat([first[:, :1], second[:, 2:]], 1) * self.factor)


def declared(net, **options):
    return rf.TorchModel(net, **{"scaling": "0-255", "device": "cpu", **options})


@pytest.mark.parametrize("layout", ["pair", "concatenated", "stacked", "images"])
def test_every_input_layout_gives_the_same_flow(layout):
    model = declared(Channels(layout), layout=layout)
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))
    assert model.identity()["layout"] == layout


def test_what_is_not_declared_has_the_stated_defaults():
    plain = rf.TorchModel(Channels(), device="cpu")
    np.testing.assert_allclose(plain.predict(*noise_pair()), channel_flow(*noise_pair()) / 255, atol=1e-6)
    stated = {"scaling": "0-1", "order": "rgb", "multiple": 8, "layout": "pair", "output": -1}
    assert plain.identity() == rf.TorchModel(Channels(), device="cpu", **stated).identity()


def test_a_network_of_torchvision_needs_no_declaration():
    optical_flow = pytest.importorskip("torchvision", reason="needs the torch extra").models.optical_flow
    torch.manual_seed(0)
    net = optical_flow.raft_small(weights=None).eval()
    image1, image2 = textured_pair(128, 192)
    with torch.inference_mode():
        inputs = [torch.from_numpy(image).permute(2, 0, 1)[None] / 127.5 - 1 for image in (image1, image2)]
        flow = net(*inputs)[-1][0].permute(1, 2, 0).numpy()
    assert np.abs(flow).max() > 0.1
    np.testing.assert_allclose(as_model(net, "it").predict(image1, image2), flow, atol=1e-3)


OUTPUTS = {
    "list": (lambda flow: [flow * 2, flow], None),
    "first of a tuple": (lambda flow: (flow, flow * 2), 0),
    "dictionary": (lambda flow: {"flow": flow, "other": flow * 2}, "flow"),
    "list in a dictionary": (lambda flow: {"flow": [flow * 2, flow], "info": flow * 3}, "flow"),
    "ptlflow": (lambda flow: {"flows": flow[:, None]}, "flows"),
    "channels last": (lambda flow: flow.permute(0, 2, 3, 1), None),
}


@pytest.mark.parametrize(("returns", "output"), OUTPUTS.values(), ids=OUTPUTS)
def test_every_output_format_is_converted_to_flow(returns, output):
    model = declared(Channels(returns=returns), output=output)
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))


WRONG_OUTPUTS = [
    (lambda flow: flow.int(), None, ModelError, "int32"),
    (lambda flow: flow > 0, None, ModelError, "bool"),
    (lambda flow: torch.complex(flow, flow), None, ModelError, "complex64"),
    (lambda flow: flow.to_sparse(), None, ModelError, "sparse_coo"),
    (lambda flow: flow.to("meta"), None, ModelError, "float32 without values (on the device meta)"),
    (lambda flow: flow.numpy(), None, ModelError, "output=0"),
    (lambda flow: flow[:, :1], None, ModelError, "(1, 1, 16, 24)"),
    (lambda flow: [flow, flow], 5, UsageError, "output=5"),
    (lambda flow: [flow, flow], -3, UsageError, "output=-3"),
    (lambda flow: {"flow": flow}, "flwo", UsageError, "output=flwo"),
]


@pytest.mark.parametrize(("returns", "output", "error", "culprit"), WRONG_OUTPUTS)
def test_output_that_is_no_flow_is_refused(returns, output, error, culprit):
    model = declared(Channels(returns=returns), output=output)
    refusal(lambda: model.predict(*noise_pair()), error, culprit)


@pytest.mark.parametrize("layer", [nn.LazyConv2d(2, 3), nn.Conv2d(3, 2, 3, device="meta")], ids=["lazy", "meta"])
def test_module_whose_weights_have_no_values_is_refused(layer):
    net = Channels()
    net.added = layer
    refusal(lambda: declared(net), ModelError, "added.weight")


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"scaling": "0-2"}, "0-2"),
        ({"order": "gbr"}, "gbr"),
        ({"layout": "both"}, "both"),
        ({"multiple": 1025}, "multiple"),
        ({"multiple": 0}, "multiple"),
        ({"precision": "fp64"}, "fp64"),
        ({"sha256": "0" * 64}, "sha256"),
        ({"batched": "no"}, "batched"),
    ],
)
def test_invalid_options_of_user_modules_are_refused(options, culprit):
    refusal(lambda: declared(Channels(), **options), UsageError, culprit)


def test_module_of_the_user_is_not_modified():
    net = Channels().train()
    declared(net).predict(*noise_pair())
    assert net.training
    assert net.norm.training
    assert net.factor.requires_grad


def test_identity_holds_the_weights_and_the_format_and_not_the_name():
    net = Channels()
    one = declared(net).identity()
    assert one == declared(net, name="Mine").identity()
    others = (Channels(factor=2), {}), (net, {"order": "bgr"}), (net, {"scaling": "0-1"}), (net, {"multiple": 16})
    assert all(declared(other, **options).identity() != one for other, options in others)


def test_weights_are_read_from_a_file(tmp_path):
    state = {f"module.{key}": value for key, value in Channels(factor=2).state_dict().items()}
    torch.save({"state_dict": state, "robustflow_trained_on": "C+T"}, tmp_path / "w.pt")
    model = declared(Channels(), checkpoint=tmp_path / "w.pt")
    np.testing.assert_array_equal(model.predict(*noise_pair()), 2.0 * channel_flow(*noise_pair()))
    assert model.trained_on == "C+T"
    assert declared(Channels(), checkpoint=tmp_path / "w.pt", trained_on="K").trained_on == "K"


def test_command_line_accepts_a_module_or_a_factory(tmp_path, monkeypatch):
    (tmp_path / "nets_of_a_user.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    first, second = noise_pair()
    options = {"scaling": "0-255", "order": "rgb", "device": "cpu"}
    for attribute, given, gain in (("Net", {}, 1), ("factory", {}, 2), ("net", {}, 3), ("factory", {"gain": 5.0}, 5)):
        model = rf.load_model(f"nets_of_a_user:{attribute}", **given, **options)
        np.testing.assert_array_equal(model.predict(first, second), first[..., :2] * np.float32(gain))
    spec = ModelRef.parse("nets_of_a_user:factory", tuple(options.items()))
    assert spec.identity(spec.load())["input"]["scale"] == 1.0
    refusal(lambda: rf.load_model("nets_of_a_user:factory", gian=5.0, **options), UsageError, "gian")
    broken = rf.load_model("nets_of_a_user:Broken", **options)
    assert "nets_of_a_user.py:18" in str(refusal(lambda: broken.predict(first, second), ModelError, "Broken"))

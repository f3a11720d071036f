"""The convention of a user-defined PyTorch module is declared, defined by its library, determined by experiment, or
unknown.
"""

import warnings

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch import nn

import robustflow as rf
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelSpec
from robustflow.models.loading import as_model
from robustflow.models.torch.shifted import SHIFTS, shifted_pair
from robustflow.models.torch.user_model import ConventionWarning

from ...refusals import refused
from ..textures import channel_flow, noise_pair
from .matcher import trained_matcher

pytestmark = [
    pytest.mark.torch,
    pytest.mark.filterwarnings("ignore::robustflow.models.torch.user_model.ConventionWarning"),
]
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
    """Return the first channel of the first image as u and the last channel of the second image as v, for every
    convention.
    """

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
            if images[0].shape[1] != 6:
                raise ValueError("six channels")
            images = images[0][:, :3], images[0][:, 3:]
        first, second = images
        return self.returns(torch.cat([first[:, :1], second[:, 2:]], 1) * self.factor)


def declared(net, **options):
    return rf.TorchModel(net, **{"scaling": "0-255", "order": "rgb", "device": "cpu", **options})


@pytest.mark.parametrize("layout", ["pair", "concatenated", "stacked", "images"])
@pytest.mark.parametrize("said", [True, False])
def test_every_input_convention_works_declared_or_detected(layout, said):
    model = declared(Channels(layout), **({"layout": layout} if said else {}))
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))
    assert model.identity()["layout"] == layout


WAYS_OUT = {
    "list": (lambda flow: [flow * 2, flow], None),
    "first of a tuple": (lambda flow: (flow, flow * 2), 0),
    "dictionary": (lambda flow: {"flow": flow, "other": flow * 2}, "flow"),
    "list in a dictionary": (lambda flow: {"flow": [flow * 2, flow], "info": flow * 3}, "flow"),
    "ptlflow": (lambda flow: {"flows": flow[:, None]}, "flows"),
    "channels last": (lambda flow: flow.permute(0, 2, 3, 1), None),
}


@pytest.mark.parametrize("way", WAYS_OUT)
def test_every_output_format_is_converted_to_flow(way):
    returns, output = WAYS_OUT[way]
    model = declared(Channels(returns=returns), layout="pair", output=output)
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))


NOT_A_FLOW = {
    "int": (lambda flow: flow.int(), "a tensor of int32"),
    "bool": (lambda flow: flow > 0, "a tensor of bool"),
    "complex": (lambda flow: torch.complex(flow, flow), "a tensor of complex64"),
    "sparse": (lambda flow: flow.to_sparse(), "a tensor of sparse_coo"),
    "meta": (lambda flow: flow.to("meta"), r"a tensor of float32 without values \(on the device meta\)"),
    "array": (lambda flow: flow.numpy(), "output '0' of the network is ndarray, not a tensor"),
}


@pytest.mark.parametrize("kind", NOT_A_FLOW)
def test_output_without_floating_point_values_is_refused(kind):
    returns, says = NOT_A_FLOW[kind]
    model = declared(Channels(returns=returns), layout="pair")
    with refused(ModelError, says):
        model.predict(*noise_pair())


@pytest.mark.parametrize(
    ("returns", "output", "known"),
    [
        (lambda flow: [flow, flow], 5, "0, 1"),
        (lambda flow: [flow, flow], -3, "0, 1"),
        (lambda flow: {"flow": flow}, "flwo", "flow"),
    ],
)
def test_output_that_the_module_lacks_is_refused_by_the_name_of_the_option(returns, output, known):
    with refused(UsageError, f"^output={output}: the network has no such output; choose from {known}$"):
        declared(Channels(returns=returns), layout="pair", output=output)


@pytest.mark.parametrize(
    ("layer", "says"),
    [
        (nn.LazyConv2d(2, 3), "'added.weight' of Channels is in a lazy layer: call the module once"),
        (nn.Conv2d(3, 2, 3, device="meta"), "'added.weight' of Channels is a tensor of float32 without values"),
    ],
    ids=["lazy", "meta"],
)
def test_module_whose_weights_have_no_values_is_refused(layer, says):
    net = Channels()
    net.added = layer
    with refused(ModelError, says):
        declared(net, layout="pair")


def test_module_of_the_user_is_not_modified():
    net = Channels().train()
    declared(net).predict(*noise_pair())
    assert net.training
    assert net.norm.training
    assert net.factor.requires_grad


def test_identity_holds_the_weights_and_the_convention_and_not_the_name():
    net = Channels()
    one = declared(net, layout="pair").identity()
    assert one == declared(net, name="Mine", layout="pair").identity()
    assert one["input"]["multiple"] == 8
    changed = [
        declared(Channels(factor=2)),
        declared(net, order="bgr"),
        declared(net, scaling="0-1"),
        declared(net, multiple=16),
    ]
    assert all(model.identity() != one for model in changed)


def test_weights_are_read_from_a_file(tmp_path):
    state = {f"module.{key}": value for key, value in Channels(factor=2).state_dict().items()}
    torch.save({"state_dict": state, "robustflow_trained_on": "C+T"}, tmp_path / "w.pt")
    model = declared(Channels(), checkpoint=tmp_path / "w.pt")
    np.testing.assert_array_equal(model.predict(*noise_pair()), 2.0 * channel_flow(*noise_pair()))
    assert model.trained_on == "C+T"
    assert declared(Channels(), checkpoint=tmp_path / "w.pt", trained_on="K").trained_on == "K"
    with pytest.raises(ModelError, match="no such checkpoint"):
        declared(Channels(), checkpoint=tmp_path / "x.pt")


def test_a_network_of_torchvision_needs_no_declaration():
    optical_flow = pytest.importorskip("torchvision", reason="needs the torch extra").models.optical_flow
    torch.manual_seed(0)
    net = optical_flow.raft_small(weights=None).eval()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = as_model(net, "it")
    image1, image2 = (shifted_pair(0)[i] for i in (0, 1))
    with torch.inference_mode():
        inputs = [torch.from_numpy(image).permute(2, 0, 1)[None] / 127.5 - 1 for image in (image1, image2)]
        flow = net(*inputs)[-1][0].permute(1, 2, 0).numpy()
    assert np.abs(flow).max() > 0.1
    np.testing.assert_allclose(model.predict(image1, image2), flow, atol=1e-3)


def test_the_order_of_a_trained_network_is_found_and_reported():
    net = trained_matcher()
    with pytest.warns(
        ConventionWarning,
        match=r"Matcher: the model does not declare .*; scaling=-1-1, order=bgr, layout=pair, output=-1 is used",
    ):
        model = rf.TorchModel(net, scaling="-1-1", device="cpu")
    assert model.identity()["input"]["order"] == "bgr"
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5 < np.hypot(*pair.shift)


@pytest.mark.slow
def test_the_whole_convention_of_a_trained_network_is_found():
    with pytest.warns(ConventionWarning, match="scaling=-1-1, order=bgr, layout=pair, output=-1 is used"):
        model = rf.TorchModel(trained_matcher(), device="cpu")
    assert (model.declared.scaling, model.declared.order) == ("-1-1", "bgr")


@pytest.mark.parametrize(
    ("net", "options", "says"),
    [
        (Channels(), {"layout": "pair"}, "as is typical of networks without trained weights; declare the input, for"),
        (nn.Conv2d(3, 2, 3), {}, "does not accept a pair in any common way"),
    ],
    ids=["untrained", "no flow"],
)
def test_undecidable_convention_asks_for_a_declaration(net, options, says):
    with refused(ModelError, says):
        rf.TorchModel(net, device="cpu", **options)


def test_network_that_fails_on_the_textures_is_accepted_with_a_warning():
    class Fixed(nn.Module):
        def forward(self, image1, image2):
            if image1.shape[2:] != (64, 96):
                raise ValueError("64x96 only")
            return image1[:, :2]

    with pytest.warns(ConventionWarning, match=r"could not be checked on shifted textures: .*64x96 only"):
        model = declared(Fixed(), layout="pair")
    assert model.predict(*noise_pair(64, 96)).shape == (64, 96, 2)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"scaling": "0-2"}, "unknown scaling '0-2'"),
        ({"order": "gbr"}, "unknown order 'gbr'"),
        ({"layout": "both"}, "unknown layout 'both'"),
        ({"multiple": 1025}, "multiple must be an integer from 1 to 1024, not 1025"),
        ({"multiple": 0}, "multiple must be an integer from 1 to 1024"),
        ({"precision": "fp64"}, "unknown precision 'fp64'"),
        ({"sha256": "0" * 64}, "sha256 refers to a checkpoint file"),
    ],
)
def test_invalid_options_of_user_modules_are_refused(options, says):
    with pytest.raises(UsageError, match=says):
        declared(Channels(), **options)


def test_command_line_accepts_a_module_or_a_factory(tmp_path, monkeypatch):
    (tmp_path / "nets_of_a_user.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    first, second = noise_pair()
    options = {"scaling": "0-255", "order": "rgb", "device": "cpu"}
    for attribute, given, gain in (
        ("Net", {}, 1.0),
        ("factory", {}, 2.0),
        ("net", {}, 3.0),
        ("factory", {"gain": 5.0}, 5.0),
    ):
        model = rf.load_model(f"nets_of_a_user:{attribute}", **given, **options)
        np.testing.assert_array_equal(model.predict(first, second), first[..., :2] * gain)
    spec = ModelSpec("nets_of_a_user:factory", tuple(options.items()))
    assert spec.identity(spec.load())["input"]["scale"] == 1.0
    with pytest.raises(UsageError, match="unknown option of model 'nets_of_a_user:factory' 'gian'"):
        rf.load_model("nets_of_a_user:factory", gian=5.0, **options)
    broken = rf.load_model("nets_of_a_user:Broken", layout="pair", **options)
    with refused(ModelError, r"AttributeError: .*no_such_thing.* \(at .*nets_of_a_user\.py:18\)"):
        broken.predict(first, second)


def test_shifted_texture_pairs_have_their_stated_shift():
    for index, shift in enumerate(SHIFTS):
        pair = shifted_pair(index)
        u, v = pair.shift
        assert (u, v) == shift
        inner = pair.frame1[10:-10, 10:-10]
        np.testing.assert_array_equal(inner, pair.frame2[10 + v : -10 + v, 10 + u : -10 + u])
        assert pair.error(np.full((*inner.shape[:2], 2), shift, np.float32)) == 0
        assert inner.std() > 20

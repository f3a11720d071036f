"""The convention of a user's PyTorch module: declared, known by its library, found by trying, or not found."""

import warnings

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch import nn

import robustflow as rf
from robustflow.errors import ModelError, UsageError
from robustflow.models import ModelSpec
from robustflow.models.construct import as_model
from robustflow.models.torch.shifted import SHIFTS, shifted_pair
from robustflow.models.torch.user_model import ConventionWarning

from .matcher import trained_matcher
from .small_net import one_line

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
    """u is the first image's first channel, v the second's last, in whatever way they come in and go out."""

    def __init__(self, layout="pair", returns=lambda flow: flow):
        super().__init__()
        self.layout, self.returns = layout, returns
        self.one = nn.Parameter(torch.ones(1))
        self.norm = nn.BatchNorm2d(2)  # of which nothing is used: only its mode matters

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
        return self.returns(torch.cat([first[:, :1], second[:, 2:]], 1) * self.one)


def frames(height=13, width=19, seed=0):
    return list(np.random.default_rng(seed).integers(0, 256, (2, height, width, 3)).astype(np.uint8))


def declared(net, **options):
    return rf.TorchModel(net, **{"scaling": "0-255", "order": "rgb", "device": "cpu", **options})


def expected(first, second):
    return np.stack([first[..., 0], second[..., 2]], 2)


@pytest.mark.parametrize("layout", ["pair", "concatenated", "stacked", "images"])
@pytest.mark.parametrize("said", [True, False])
def test_every_way_in_declared_or_the_only_one_that_works(layout, said):
    model = declared(Channels(layout), **({"layout": layout} if said else {}))
    np.testing.assert_array_equal(model.predict(*frames()), expected(*frames()))
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
def test_every_way_out(way):
    returns, output = WAYS_OUT[way]
    model = declared(Channels(returns=returns), layout="pair", output=output)
    np.testing.assert_array_equal(model.predict(*frames()), expected(*frames()))


def test_the_module_of_the_user_stays_as_it_was():
    net = Channels().train()
    declared(net).predict(*frames())
    assert net.training
    assert net.norm.training
    assert net.one.requires_grad


def test_identity_holds_the_weights_and_the_convention_and_not_the_name():
    net = Channels()
    one = declared(net, layout="pair").identity()
    assert one == declared(net, name="Mine", layout="pair").identity()
    assert one["input"]["multiple"] == 8
    other = Channels()
    with torch.no_grad():
        other.one.mul_(2)
    changed = [declared(other), declared(net, order="bgr"), declared(net, scaling="0-1"), declared(net, multiple=16)]
    assert all(model.identity() != one for model in changed)


def test_weights_of_a_file(tmp_path):
    other = Channels()
    with torch.no_grad():
        other.one.mul_(2)
    torch.save({"state_dict": {f"module.{key}": value for key, value in other.state_dict().items()}}, tmp_path / "w.pt")
    model = declared(Channels(), checkpoint=tmp_path / "w.pt")
    np.testing.assert_array_equal(model.predict(*frames()), 2.0 * expected(*frames()))
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
        ConventionWarning, match=r"Matcher: it does not declare .* using scaling=-1-1, order=bgr, layout=pair"
    ):
        model = rf.TorchModel(net, scaling="-1-1", device="cpu")
    assert model.identity()["input"]["order"] == "bgr"
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5 < np.hypot(*pair.shift)


@pytest.mark.slow
def test_the_whole_convention_of_a_trained_network_is_found():
    with pytest.warns(ConventionWarning, match="using scaling=-1-1, order=bgr, layout=pair, output=-1"):
        model = rf.TorchModel(trained_matcher(), device="cpu")
    assert (model.declared.scaling, model.declared.order) == ("-1-1", "bgr")


class AnyRange(nn.Module):
    """The trained network behind a norm works equally well with every range, so none can be found."""

    def __init__(self):
        super().__init__()
        self.net = trained_matcher()

    def forward(self, image1, image2):
        images = (
            (image - image.mean((2, 3), True)) / image.std((2, 3), keepdim=True) / 2 for image in (image1, image2)
        )
        return self.net(*images)


@pytest.mark.parametrize(
    ("net", "options", "says"),
    [
        (
            AnyRange(),
            {"order": "bgr"},
            r"best first: scaling=.* px\); scaling=.*; declare the one it was trained with, the first with ",
        ),
        (Channels(), {}, "as for networks without trained weights; declare it, for"),
        (nn.Conv2d(3, 2, 3), {}, "accepts a pair in none of the common ways"),
    ],
    ids=["any range", "untrained", "no flow"],
)
def test_what_cannot_be_told_asks_for_a_declaration(net, options, says):
    with pytest.raises(ModelError, match=says) as error:
        rf.TorchModel(net, device="cpu", layout=None if isinstance(net, nn.Conv2d) else "pair", **options)
    one_line(error)


_MEAN, _STD = (torch.tensor(values).view(1, 3, 1, 1) for values in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
TO_ITS_RANGE = {
    "0-1": lambda x: 2 * x - 1,
    "-1-1": lambda x: x,
    "0-255": lambda x: x / 127.5 - 1,
    "imagenet": lambda x: 2 * (x * _STD + _MEAN) - 1,
}


class Version(nn.Module):
    """`tiny` behind a convention, returning what `returns` makes of its flows, coarsest first."""

    def __init__(self, returns=lambda flows: flows[-1], scaling="-1-1", order="rgb", layout="pair", backward=False):
        super().__init__()
        self.net, self.returns = rf.load_model("tiny", device="cpu", runtime="torch").net, returns
        self.scaling, self.order, self.layout, self.backward = scaling, order, layout, backward

    def forward(self, *images):
        if self.layout == "images":
            images = (images[0]["images"],)
        if self.layout in ("images", "stacked"):
            images = images[0].unbind(1)
        elif self.layout == "concatenated":
            images = images[0][:, :3], images[0][:, 3:]
        images = [TO_ITS_RANGE[self.scaling](image.flip(1) if self.order == "bgr" else image) for image in images]
        return self.returns(self.net.predictions(*(images[::-1] if self.backward else images)))


def _signs(u, v):
    return torch.tensor([u, v]).view(1, 2, 1, 1)


RIGHT = {
    **{
        f"{s} {o}": ({"scaling": s, "order": o}, {"scaling": s, "order": o})
        for s in TO_ITS_RANGE
        for o in ("rgb", "bgr")
    },
    **{layout: ({"layout": layout}, {"layout": layout}) for layout in ("concatenated", "stacked", "images")},
    "list": ({"returns": lambda flows: flows}, {}),
    "finest first": ({"returns": lambda flows: tuple(flows[::-1])}, {"output": 0}),
    "dictionary": ({"returns": lambda flows: {"flow": flows[-1], "coarse": flows[0]}}, {"output": "flow"}),
    "list in a dictionary": ({"returns": lambda flows: {"flows": flows, "info": 0 * flows[0]}}, {"output": "flows"}),
    "channels last": ({"returns": lambda flows: flows[-1].permute(0, 2, 3, 1)}, {}),
}
OTHER_WAY = "it points the other way, as the flow from frame 2 to frame 1 does"
REFUSED = {
    "frames reversed": ({"backward": True}, {}, OTHER_WAY),
    "frames reversed, list": ({"backward": True, "returns": lambda flows: flows}, {}, OTHER_WAY),
    "negated": ({"returns": lambda flows: -flows[-1]}, {}, OTHER_WAY),
    "(v, u)": ({"returns": lambda flows: flows[-1].flip(1)}, {}, r"its components are \(v, u\); return"),
    "(-v, -u)": ({"returns": lambda flows: -flows[-1].flip(1)}, {}, r"\(v, u\); it points the other way"),
    "u left": ({"returns": lambda flows: flows[-1] * _signs(-1.0, 1.0)}, {}, "the sign of u is the opposite"),
    "v up": ({"returns": lambda flows: flows[-1] * _signs(1.0, -1.0)}, {}, "the sign of v is the opposite"),
    "divided by 20": ({"returns": lambda flows: flows[-1] / 20}, {}, "u has to be multiplied by 20 and v by 20"),
    "divided by 4": ({"returns": lambda flows: flows[-1] / 4}, {}, "multiplied by 4 and v by 4"),
    "times 20": ({"returns": lambda flows: flows[-1] * 20}, {}, r"multiplied by 0\.05 and v by 0\.05"),
    "-1..1 over the image": ({"returns": lambda flows: flows[-1] / _signs(96.0, 64.0)}, {}, "by 95 and v by 63"),
    "(v, u) / 20": ({"returns": lambda flows: flows[-1].flip(1) / 20}, {}, r"\(v, u\); u has to be multiplied by 20"),
    "0-255 for -1-1": ({}, {"scaling": "0-255"}, r"better, best first: scaling=-1-1, order=rgb \(0\.17 px\)"),
    "0-1 for 0-255": ({"scaling": "0-255"}, {"scaling": "0-1"}, "better, best first: scaling=0-255, order=rgb"),
}
WARNED = {
    "coarsest last": (
        {"returns": lambda flows: flows[::-1]},
        {},
        "output 0 is used, .* 0.17 px and the last by 1.7 px",
    ),
    "coarsest last by key": (
        {"returns": lambda flows: {"fine": flows[-1], "coarse": flows[0]}},
        {},
        "output fine is used",
    ),
    "coarsest first, declared": (
        {"returns": lambda flows: flows},
        {"output": 0},
        r"best first: .*output=-1 \(0.17 px\)",
    ),
    "coarsest alone": ({"returns": lambda flows: flows[0]}, {}, "off by 1.7 px .* check .* its finest flow"),
    "second level alone": ({"returns": lambda flows: flows[1]}, {}, "off by 0.68 px"),
    "halved": ({"returns": lambda flows: flows[-1] / 2}, {}, "u has to be multiplied by 2 and v by 2"),
    "doubled": ({"returns": lambda flows: flows[-1] * 2}, {}, r"u has to be multiplied by 0\.5 and v by 0\.5"),
    "zero": ({"returns": lambda flows: 0 * flows[-1]}, {}, "as networks without trained weights are"),
    "-1-1 for 0-255": ({"scaling": "0-255"}, {}, "better, best first: scaling=0-255, order=rgb"),
}
FAST = (
    "-1-1 rgb",
    "dictionary",
    "frames reversed",
    "(v, u)",
    "divided by 20",
    "coarsest last",
    "coarsest first, declared",
)


def _versions(cases):
    return [pytest.param(*cases[name], id=name, marks=() if name in FAST else pytest.mark.slow) for name in cases]


@pytest.mark.parametrize(("made", "options"), _versions(RIGHT))
def test_right_declaration_of_a_trained_network_is_accepted_without_a_word(made, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = rf.TorchModel(Version(**made), **{"scaling": "-1-1", "order": "rgb", "device": "cpu", **options})
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5


@pytest.mark.parametrize(("made", "options", "says"), _versions(REFUSED))
def test_declaration_that_the_shifted_textures_contradict_is_refused(made, options, says):
    with pytest.raises(ModelError, match=says) as error:
        rf.TorchModel(Version(**made), **{"scaling": "-1-1", "order": "rgb", "device": "cpu", **options})
    one_line(error)


@pytest.mark.parametrize(("made", "options", "says"), _versions(WARNED))
def test_declaration_that_fits_shifted_textures_badly_is_warned_about(made, options, says):
    with pytest.warns(ConventionWarning, match=f"Version: .*{says}"):
        rf.TorchModel(Version(**made), **{"scaling": "-1-1", "order": "rgb", "device": "cpu", **options})


def test_finest_output_is_used_where_none_is_declared():
    with pytest.warns(ConventionWarning, match="output fine is used"):
        model = rf.TorchModel(
            Version(lambda flows: {"fine": flows[-1], "coarse": flows[0]}), scaling="-1-1", order="rgb", device="cpu"
        )
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5
    assert model.identity()["output"] == "fine"


def test_undeclared_network_that_fits_several_conventions_names_them_best_first():
    """`tiny` is as good in BGR; the convention named first is the one it was trained with."""
    with pytest.raises(ModelError, match="several conventions fit shifted textures") as error:
        rf.TorchModel(Version(scaling="0-255"), layout="pair", device="cpu")
    one_line(error)
    said = str(error.value)
    assert "best first: scaling=0-255, order=rgb (0.17 px); scaling=0-255, order=bgr (0.18 px); " in said
    assert "TorchModel(net, scaling='0-255', order='rgb', layout='pair') or -O scaling=0-255 -O order=rgb" in said
    model = rf.TorchModel(Version(scaling="0-255"), scaling="0-255", order="rgb", layout="pair", device="cpu")
    assert model.identity()["input"]["scale"] == 1.0


@pytest.mark.slow
def test_undeclared_network_that_returns_another_flow_is_told_what_it_returns():
    with pytest.raises(ModelError, match=OTHER_WAY):
        rf.TorchModel(Version(lambda flows: -flows[-1]), layout="pair", device="cpu")


def test_network_that_fails_on_the_textures_is_warned_about_and_kept():
    class Fixed(nn.Module):
        def forward(self, image1, image2):
            if image1.shape[2:] != (64, 96):
                raise ValueError("64x96 only")
            return image1[:, :2]

    with pytest.warns(ConventionWarning, match=r"could not be checked on shifted textures: .*64x96 only"):
        model = declared(Fixed(), layout="pair")
    assert model.predict(*frames(64, 96)).shape == (64, 96, 2)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"scaling": "0-2"}, "unknown scaling '0-2'"),
        ({"order": "gbr"}, "unknown order 'gbr'"),
        ({"layout": "both"}, "unknown layout 'both'"),
        ({"multiple": 0}, "multiple must be a whole number from 1"),
        ({"precision": "fp64"}, "unknown precision 'fp64'"),
        ({"sha256": "0" * 64}, "sha256 is that of a checkpoint's file"),
    ],
)
def test_options_that_cannot_be(options, says):
    with pytest.raises(UsageError, match=says):
        declared(Channels(), **options)


def test_module_and_factory_from_the_command_line(tmp_path, monkeypatch):
    (tmp_path / "nets_of_a_user.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    first, second = frames()
    options = {"scaling": "0-255", "order": "rgb", "device": "cpu"}
    for attribute, gain in (("Net", 1.0), ("factory", 2.0), ("net", 3.0)):
        model = rf.load_model(f"nets_of_a_user:{attribute}", **options)
        np.testing.assert_array_equal(model.predict(first, second), first[..., :2] * gain)
    model = rf.load_model("nets_of_a_user:factory", gain=5.0, **options)
    np.testing.assert_array_equal(model.predict(first, second), first[..., :2] * 5.0)
    spec = ModelSpec("nets_of_a_user:factory", tuple(options.items()))
    assert spec.identity(spec.load())["input"]["scale"] == 1.0
    with pytest.raises(UsageError, match="unknown option of model 'nets_of_a_user:factory' 'gian'"):
        rf.load_model("nets_of_a_user:factory", gian=5.0, **options)
    broken = rf.load_model("nets_of_a_user:Broken", layout="pair", **options)
    with pytest.raises(ModelError, match=r"AttributeError: .*no_such_thing.* \(at .*nets_of_a_user\.py:18\)") as error:
        broken.predict(first, second)
    one_line(error)


def test_every_shifted_pair_is_what_it_says():
    for index, shift in enumerate(SHIFTS):
        pair = shifted_pair(index)
        u, v = pair.shift
        assert (u, v) == shift
        inner = pair.frame1[10:-10, 10:-10]
        np.testing.assert_array_equal(inner, pair.frame2[10 + v : -10 + v, 10 + u : -10 + u])
        assert pair.error(np.full((*inner.shape[:2], 2), shift, np.float32)) == 0
        assert inner.std() > 20

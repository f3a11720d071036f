"""The convention of a trained network: correct declarations are accepted, wrong ones are rejected or cause a warning,
and missing ones are determined by experiment.
"""

import warnings

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch
from torch import nn

import robustflow as rf
from robustflow.core.errors import ModelError
from robustflow.models.torch.shifted import shifted_pair
from robustflow.models.torch.user_model import ConventionWarning

from ...refusals import refused

pytestmark = [
    pytest.mark.torch,
    pytest.mark.filterwarnings("ignore::robustflow.models.torch.user_model.ConventionWarning"),
]


_MEAN, _STD = (torch.tensor(values).view(1, 3, 1, 1) for values in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
TO_ITS_RANGE = {
    "0-1": lambda x: 2 * x - 1,
    "-1-1": lambda x: x,
    "0-255": lambda x: x / 127.5 - 1,
    "imagenet": lambda x: 2 * (x * _STD + _MEAN) - 1,
}


class Version(nn.Module):
    """`tiny` with a given input convention; its flows, coarsest first, are passed through `returns`."""

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
OTHER_WAY = r"it looks backward \(negated\)"
REFUSED = {
    "frames reversed": ({"backward": True}, {}, OTHER_WAY),
    "frames reversed, list": ({"backward": True, "returns": lambda flows: flows}, {}, OTHER_WAY),
    "negated": ({"returns": lambda flows: -flows[-1]}, {}, OTHER_WAY),
    "(v, u)": ({"returns": lambda flows: flows[-1].flip(1)}, {}, r"it looks swapped to \(v, u\); return"),
    "(-v, -u)": ({"returns": lambda flows: -flows[-1].flip(1)}, {}, r"swapped to \(v, u\), backward"),
    "u left": ({"returns": lambda flows: flows[-1] * _signs(-1.0, 1.0)}, {}, "it looks inverted in u"),
    "v up": ({"returns": lambda flows: flows[-1] * _signs(1.0, -1.0)}, {}, "it looks inverted in v"),
    "divided by 20": ({"returns": lambda flows: flows[-1] / 20}, {}, "about 16 times too short"),
    "divided by 4": ({"returns": lambda flows: flows[-1] / 4}, {}, "about 4 times too short"),
    "times 20": ({"returns": lambda flows: flows[-1] * 20}, {}, "about 16 times too long"),
    "-1..1 over the image": (
        {"returns": lambda flows: flows[-1] / _signs(96.0, 64.0)},
        {},
        "divided by half the size of the frame",
    ),
    "(v, u) / 20": (
        {"returns": lambda flows: flows[-1].flip(1) / 20},
        {},
        r"swapped to \(v, u\), about 16 times too short",
    ),
    "0-255 for -1-1": (
        {},
        {"scaling": "0-255"},
        r"better conventions, best first: scaling=-1-1, order=rgb \(0\.17 px\)",
    ),
    "0-1 for 0-255": (
        {"scaling": "0-255"},
        {"scaling": "0-1"},
        "better conventions, best first: scaling=0-255, order=rgb",
    ),
}
WARNED = {
    "coarsest last": (
        {"returns": lambda flows: flows[::-1]},
        {},
        "output 0 is used, .* 0.17 px, and that of the last output is 1.7 px",
    ),
    "coarsest first, declared": (
        {"returns": lambda flows: flows},
        {"output": 0},
        r"best first: .*output=-1 \(0.17 px\)",
    ),
    "coarsest alone": (
        {"returns": lambda flows: flows[0]},
        {},
        "its error with .* is 1.7 px, .* check .* its finest flow",
    ),
    "second level alone": ({"returns": lambda flows: flows[1]}, {}, "is 0.68 px, while"),
    "halved": ({"returns": lambda flows: flows[-1] / 2}, {}, "it looks about 2 times too short"),
    "doubled": ({"returns": lambda flows: flows[-1] * 2}, {}, "it looks about 2 times too long"),
    "zero": ({"returns": lambda flows: 0 * flows[-1]}, {}, "as is typical of networks without trained weights"),
    "-1-1 for 0-255": ({"scaling": "0-255"}, {}, "better conventions, best first: scaling=0-255, order=rgb"),
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


def declared(made, options):
    return rf.TorchModel(Version(**made), **{"scaling": "-1-1", "order": "rgb", "device": "cpu", **options})


@pytest.mark.parametrize(("made", "options"), _versions(RIGHT))
def test_correct_declaration_of_a_trained_network_gives_no_warning(made, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = declared(made, options)
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5


@pytest.mark.parametrize(("made", "options", "says"), _versions(REFUSED))
def test_declaration_that_the_shifted_textures_contradict_is_refused(made, options, says):
    with refused(ModelError, says):
        declared(made, options)


@pytest.mark.parametrize(("made", "options", "says"), _versions(WARNED))
def test_declaration_that_fits_shifted_textures_badly_is_warned_about(made, options, says):
    with pytest.warns(ConventionWarning, match=f"Version: .*{says}"):
        declared(made, options)


def test_finest_output_is_used_where_none_is_declared():
    with pytest.warns(ConventionWarning, match="Version: .*output fine is used"):
        model = declared({"returns": lambda flows: {"fine": flows[-1], "coarse": flows[0]}}, {})
    pair = shifted_pair(1000)
    assert pair.error(model.predict(*pair[:2])) < 0.5
    assert model.identity()["output"] == "fine"


def test_undeclared_network_that_fits_several_conventions_names_them_best_first():
    """`tiny` is equally accurate on BGR frames; the convention that is listed first is the one used in training."""
    with refused(ModelError, "several conventions work about equally well") as error:
        rf.TorchModel(Version(scaling="0-255"), layout="pair", device="cpu")
    message = str(error.value)
    assert "best first: scaling=0-255, order=rgb (0.17 px); scaling=0-255, order=bgr (0.18 px); " in message
    assert "TorchModel(net, scaling='0-255', order='rgb', layout='pair') or -O scaling=0-255 -O order=rgb" in message
    model = rf.TorchModel(Version(scaling="0-255"), scaling="0-255", order="rgb", layout="pair", device="cpu")
    assert model.identity()["input"]["scale"] == 1.0


@pytest.mark.slow
def test_undeclared_network_with_a_different_flow_format_is_refused_with_that_format():
    with pytest.raises(ModelError, match=OTHER_WAY):
        rf.TorchModel(Version(lambda flows: -flows[-1]), layout="pair", device="cpu")

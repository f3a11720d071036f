"""TorchScript and torch.export files: the same conventions as ONNX, our own networks' numbers, nothing hostile run."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the torch extra")

import torch

import robustflow as rf
from robustflow.errors import ModelError, UsageError
from robustflow.models.base import BatchedFlowModel

from ..textures import textured_pair
from ..torch.small_net import Payload, one_line

pytestmark = [
    pytest.mark.torch,
    pytest.mark.filterwarnings("ignore"),  # of the exporters, about what they will do one day
]
AUTO = torch.export.Dim.AUTO


class Channels(torch.nn.Module):
    """u is the first frame's first channel, v the second frame's third."""

    def __init__(self, layout="pair", channels_last=False, several=None):
        super().__init__()
        self.layout, self.channels_last, self.several = layout, channels_last, several
        self.one = torch.nn.Parameter(torch.ones(1))

    def forward(self, *images):
        if self.layout == "stacked":
            first, second = images[0][:, 0], images[0][:, 1]
        elif self.layout == "concatenated":
            first, second = images[0][:, :3], images[0][:, 3:]
        else:
            first, second = images
        flow = torch.cat([first[:, :1], second[:, 2:]], 1) * self.one
        flow = flow.permute(0, 2, 3, 1).contiguous() if self.channels_last else flow
        if self.several == "list":
            return [first * 2, flow]
        return {"flow": flow, "features": first * 2} if self.several == "dict" else flow


SHAPES = {"pair": [(2, 3, 16, 24)] * 2, "stacked": [(2, 2, 3, 16, 24)], "concatenated": [(2, 6, 16, 24)]}


def save(path, net=None, dynamic=True):
    """Export a network by the ending of the path."""
    net = (net or Channels()).eval()
    inputs = tuple(torch.zeros(shape if dynamic else (1, *shape[1:])) for shape in SHAPES[net.layout])
    if path.suffix == ".pt2":
        sides = tuple({0: AUTO, x.ndim - 2: AUTO, x.ndim - 1: AUTO} if dynamic else None for x in inputs)
        if len(inputs) > 1 or dynamic:
            sides = (sides,)  # of *images
        torch.export.save(torch.export.export(net, inputs, dynamic_shapes=sides if dynamic else None), path)
    else:
        torch.jit.trace(net, inputs, strict=False).save(str(path))
    return path


def frames(height=13, width=19, seed=0):
    return list(np.random.default_rng(seed).integers(0, 256, (2, height, width, 3)).astype(np.uint8))


KINDS = pytest.mark.parametrize("ending", [".ts", ".pt2"])


def load(path, **options):
    return rf.load_model(str(path), device="cpu", **options)


@KINDS
@pytest.mark.parametrize("layout", SHAPES)
@pytest.mark.parametrize("channels_last", [False, True])
def test_every_way_in_and_out(tmp_path, ending, layout, channels_last):
    path = save(tmp_path / f"net{ending}", Channels(layout, channels_last))
    told = {"layout": layout} if ending == ".ts" else {}
    first, second = frames()
    model = load(path, scaling="0-255", **told)
    np.testing.assert_array_equal(model.predict(first, second), np.stack([first[..., 0], second[..., 2]], 2))
    identity = model.identity()
    assert identity["layout"] == layout
    assert identity["name"] == f"{'torchscript' if ending == '.ts' else 'torch_export'}:net"
    assert len(identity["checkpoint"]) == 64


@KINDS
def test_colours_and_range(tmp_path, ending):
    path = save(tmp_path / f"net{ending}")
    first, second = (frame / 255.0 for frame in frames())
    flow = load(path, order="bgr", scaling="imagenet").predict(*frames())
    expected = np.stack([(first[..., 2] - 0.406) / 0.225, (second[..., 0] - 0.485) / 0.229], axis=2)
    np.testing.assert_allclose(flow, expected, atol=1e-6)


@KINDS
@pytest.mark.parametrize("several", ["list", "dict"])
def test_the_flow_among_several_outputs(tmp_path, ending, several):
    path = save(tmp_path / f"net{ending}", Channels(several=several))
    chosen = {"output": "flow"} if several == "dict" else {}
    first, second = frames()
    np.testing.assert_array_equal(load(path, scaling="0-255", **chosen).predict(first, second)[..., 0], first[..., 0])
    with pytest.raises(ModelError, match="has no flow as output '7'; its outputs are"):
        load(path, output=7).predict(first, second)
    with pytest.raises(ModelError, match=r"shape \(1, 3, 16, 24\) for 1 inputs of 16x24; expected \(1, 2, 16, 24\)"):
        load(path, output="features" if several == "dict" else 0).predict(first, second)


@KINDS
def test_batches_change_nothing_and_keep_their_order(tmp_path, ending):
    path = save(tmp_path / f"net{ending}")
    pairs = [frames(*size, seed=i) for i, size in enumerate([(13, 19), (8, 8), (13, 19), (13, 19)])]
    for options in ({}, {"batched": True}) if ending == ".ts" else ({},):
        model = load(path, scaling="0-255", **options)
        assert isinstance(model, BatchedFlowModel)
        assert model.net.batched == (ending == ".pt2" or bool(options))
        together = model.predict_batch([first for first, _ in pairs], [second for _, second in pairs])
        for flow, (first, second) in zip(together, pairs, strict=True):
            np.testing.assert_array_equal(flow, np.stack([first[..., 0], second[..., 2]], 2))
        first, second = ([pairs[i][frame] for i in (0, 2, 3)] for frame in range(2))
        np.testing.assert_array_equal(model.run(first, second), [together[i] for i in (0, 2, 3)])  # as on a GPU


@pytest.mark.parametrize("ending", [".pt2", ".onnx"])
def test_a_network_that_lost_a_frame_in_its_export_is_refused(tmp_path, ending):
    """Both exporters take one tensor given twice for one input."""
    path, same = tmp_path / f"net{ending}", torch.zeros(1, 3, 16, 24)
    exported = torch.export.export(Channels().eval(), (same, same))
    if ending == ".pt2":
        torch.export.save(exported, path)
    else:
        pytest.importorskip("onnxscript", reason="the exporter of torch needs onnxscript")
        torch.onnx.export(exported, (same, same), path, dynamo=True, verbose=False)
    with pytest.raises(ModelError, match="does not read its input images_0") as error:
        rf.load_model(str(path), device="cpu")
    one_line(error)


def test_a_fixed_size_and_inputs_by_name(tmp_path):
    class Named(torch.nn.Module):
        layout = "pair"

        def forward(self, following, first):
            return first[:, :2] + 0 * following[:, :2]

    path = save(tmp_path / "net.pt2", Named(), dynamic=False)
    model = load(path, scaling="0-255", inputs="first,following")
    first, second = frames()
    np.testing.assert_array_equal(model.predict(first, second), first[..., :2])
    assert model.identity()["input"]["size"] == [16, 24]
    assert model.identity()["inputs"] == ["first", "following"]
    with pytest.raises(ModelError, match="up to 16x24, and one is 20x20"):
        model.predict(*frames(20, 20))
    with pytest.raises(UsageError, match="unknown input of the network 'last'"):
        load(path, inputs="last,first")


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float64])
def test_a_pt2_file_for_other_floats(tmp_path, kind):
    images = tuple(torch.zeros(1, 3, 16, 24, dtype=kind) for _ in range(2))
    torch.export.save(torch.export.export(Channels().to(kind).eval(), images), tmp_path / "net.pt2")
    first, second = frames()
    flow = load(tmp_path / "net.pt2", scaling="0-255").predict(first, second)
    assert flow.dtype == np.float32
    np.testing.assert_array_equal(flow, np.stack([first[..., 0], second[..., 2]], 2))


def test_a_pt2_file_for_integers(tmp_path):
    images = tuple(torch.zeros(1, 3, 16, 24, dtype=torch.uint8) for _ in range(2))
    torch.export.save(torch.export.export(Channels().eval(), images), tmp_path / "net.pt2")
    with pytest.raises(ModelError, match="input images_0 is uint8; expected floating-point"):
        load(tmp_path / "net.pt2")


def test_a_torchscript_file_of_one_size(tmp_path):
    path = save(tmp_path / "net.ts")
    first, second = frames()
    model = load(path, scaling="0-255", size="32x40")
    np.testing.assert_array_equal(model.predict(first, second), np.stack([first[..., 0], second[..., 2]], 2))
    with pytest.raises(ModelError, match="up to 32x40"):
        model.predict(*frames(33, 40))


@KINDS
def test_a_network_that_fails_says_on_what(tmp_path, ending):
    path = save(tmp_path / f"net{ending}", Channels("concatenated"))
    told = {"layout": "pair"} if ending == ".ts" else {"layout": "stacked"}
    with pytest.raises(
        ModelError, match=r"the network failed on input 0 \(1, 3, |does not fit; concatenated does"
    ) as error:
        load(path, **told).predict(*frames())
    one_line(error)


@KINDS
def test_raft_gives_the_flow_of_the_torch_adapter(tmp_path, ending):
    pytest.importorskip("torchvision", reason="needs the torch extra")
    original = rf.load_model("raft_small", checkpoint="random", iterations=2, device="cpu")
    images = tuple(torch.zeros(1, 3, 128, 136) for _ in range(2))
    path = tmp_path / f"raft{ending}"
    if ending == ".pt2":
        torch.export.save(torch.export.export(original.net, images), path)
    else:
        torch.jit.trace(original.net, images, check_trace=False).save(str(path))
    pair = textured_pair(127, 130)
    expected = original.predict(*pair)
    assert np.abs(expected).max() > 0.1
    flow = load(path, scaling="0-255", **({"size": "128x136"} if ending == ".ts" else {})).predict(*pair)
    np.testing.assert_allclose(flow, expected, atol=1e-4)


@pytest.mark.parametrize("dynamic", [False, True])
def test_raft_as_onnx_gives_the_flow_of_the_torch_adapter(tmp_path, dynamic):
    for library in ("torchvision", "onnx", "onnxruntime"):
        pytest.importorskip(library, reason=f"needs {library}")
    original = rf.load_model("raft_small", checkpoint="random", iterations=2, device="cpu")
    images = tuple(torch.zeros(4, 3, 128, 136) for _ in range(2))
    axes = {name: {0: "n", 2: "h", 3: "w"} for name in ("image1", "image2", "flow")} if dynamic else {}
    names = {"input_names": ["image1", "image2"], "output_names": ["flow"], "dynamic_axes": axes}
    if not dynamic:
        images = tuple(image[:1] for image in images)
    path = tmp_path / "raft.onnx"
    torch.onnx.export(original.net, images, str(path), dynamo=False, opset_version=17, **names)
    model = rf.load_model(str(path), scaling="0-255")
    pairs = [textured_pair(127, 130, seed) for seed in range(4)]
    run = model.run if dynamic else model.predict_batch
    together = run([first for first, _ in pairs], [second for _, second in pairs])
    assert model.identity()["input"].get("size") == (None if dynamic else [128, 136])
    for flow, pair in zip(together, pairs, strict=True):
        np.testing.assert_allclose(flow, original.predict(*pair), atol=1e-3)
        assert np.abs(flow - model.predict(*pair)).max() <= 1e-4


def rewritten(path, change):
    """Rewrite an archive: `change` gets {name below its root: bytes} to edit."""
    with zipfile.ZipFile(path) as archive:
        parts = {name.partition("/")[2]: archive.read(name) for name in archive.namelist()}
    change(parts)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(f"net/{name}", data)


def edit(name, change):
    """An edit of one JSON part."""

    def apply(parts):
        content = json.loads(parts[name])
        change(content)
        parts[name] = json.dumps(content).encode()

    return apply


MODEL, WEIGHTS = "models/model.json", "data/weights/model_weights_config.json"


def pickled_weight(parts):
    edit(WEIGHTS, lambda config: config["config"]["one"].update(use_pickle=True))(parts)
    parts["data/weights/weight_0"] = pickle.dumps(Payload("{marker}"))


def opaque_constant(parts):
    parts["data/constants/model_constants_config.json"] = json.dumps(
        {"config": {"c": {"path_name": "opaque_obj_0", "is_param": False, "use_pickle": True, "tensor_meta": None}}}
    ).encode()
    parts["data/constants/opaque_obj_0"] = pickle.dumps(Payload("{marker}"))


def graph(model):
    return model["graph_module"]["graph"]


def evil_size(model):
    size = {"as_expr": {"expr_str": "__import__('os').system('touch {marker}')", "hint": {"as_int": 2}}}
    graph(model)["tensor_values"][graph(model)["nodes"][0]["outputs"][0]["as_tensor"]["name"]]["sizes"][0] = size


def evil_name(model):
    graph(model)["inputs"][-1]["as_tensor"]["name"] = "x=__import__('os').system('touch {marker}')"


PAYLOADS = {
    "weight": pickled_weight,
    "constant": opaque_constant,
    "operator": edit(MODEL, lambda model: graph(model)["nodes"][0].update(target="torch.serialization.os.system")),
    "method caller": edit(MODEL, lambda model: graph(model)["nodes"][0].update(target="_operator.methodcaller")),
    "from file": edit(MODEL, lambda model: graph(model)["nodes"][0].update(target="torch.ops.aten.from_file.default")),
    "size": edit(MODEL, evil_size),
    "name": edit(MODEL, evil_name),
    "compiled": lambda parts: parts.update({"data/aotinductor/model/model.so": b"\x7fELF"}),
    "legacy weights": lambda parts: parts.update({"data/weights/model.pt": pickle.dumps(Payload("{marker}"))}),
    "containers": edit(
        MODEL,
        lambda model: model["graph_module"]["module_call_graph"][0]["signature"].update(
            in_spec=json.dumps([1, {"type": "collections.defaultdict", "context": "{}", "children_spec": []}])
        ),
    ),
}


@pytest.mark.parametrize("payload", PAYLOADS)
def test_what_a_pt2_file_could_run_is_refused(tmp_path, monkeypatch, payload):
    path = save(tmp_path / "net.pt2")
    monkeypatch.setattr(torch.export, "load", lambda *args, **options: pytest.fail("PyTorch was given the file"))
    rewritten(path, PAYLOADS[payload])
    with pytest.raises(ModelError, match=r"refused, and nothing in it was run: (it holds|its)") as error:
        load(path)
    one_line(error)


def test_example_inputs_and_guards_are_not_even_read(tmp_path):
    """The pickle of the example inputs and the text of the guards would be run by PyTorch's own loader."""
    marker = tmp_path / "ran"
    path = save(tmp_path / "net.pt2")
    inputs = io.BytesIO()
    torch.save(Payload(marker), inputs)

    def change(parts):
        parts["data/sample_inputs/model.pt"] = inputs.getvalue()
        edit(MODEL, lambda model: model.update(guards_code=[f"__import__('os').system('touch {marker}') == 0"]))(parts)

    rewritten(path, change)
    first, second = frames()
    assert np.array_equal(load(path, scaling="0-255").predict(first, second)[..., 0], first[..., 0])
    assert not marker.exists()
    torch.load(io.BytesIO(inputs.getvalue()), weights_only=False)
    assert marker.exists(), "the payload does nothing, so the test above proved nothing"


def with_code(path, line):
    def change(parts):
        (name,) = (name for name in parts if name.startswith("code/") and b"def forward" in parts[name])
        parts[name] = parts[name].replace(b"->", b"->", 1).replace(b":\n  ", b":\n    " + line + b"\n  ", 1)

    rewritten(path, change)


@pytest.mark.parametrize(
    "line",
    [
        b'torch.from_file("/etc/passwd", False, 8)',
        b'torch.save(torch.zeros([1]), "/tmp/x")',
        b'getattr(torch, "from\\x5ffile")("/etc/passwd")',
        b"ops.mylib.run()",
    ],
)
def test_a_torchscript_program_that_reaches_for_files_is_refused(tmp_path, line):
    path = save(tmp_path / "net.ts")
    with_code(path, line)
    with pytest.raises(ModelError, match="refused, and nothing in it was run: its program uses") as error:
        load(path)
    one_line(error)


def pickled_module(path):
    torch.save(Channels(), path)


def bomb(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("constants.pkl", "code/x.py", "models/model.json"):
            archive.writestr(f"net/{name}", bytes(2**26))


NO_PROGRAM = {
    "pickled module": (
        pickled_module,
        r"module pickled by torch\.save is never loaded|it is no whole file of torch\.export",
    ),
    "plain pickle": (
        lambda path: path.write_bytes(pickle.dumps(Payload(path.with_name("ran")))),
        "never loaded, because it may run code|truncated or damaged",
    ),
    "bomb": (bomb, "would unpack to"),
    "html": (lambda path: path.write_text("<html>"), "is a web page"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "cut": (lambda path: path.write_bytes(save(path).read_bytes()[:-200]), "truncated or damaged|no whole file"),
}


@KINDS
@pytest.mark.parametrize("kind", NO_PROGRAM)
def test_files_that_are_no_program(tmp_path, ending, kind):
    path = tmp_path / f"net{ending}"
    make, says = NO_PROGRAM[kind]
    make(path)
    with pytest.raises(ModelError, match=says) as error:
        load(path)
    one_line(error)
    assert os.listdir(tmp_path) == [path.name]


@KINDS
def test_a_missing_file_and_another_hash(tmp_path, ending):
    with pytest.raises(ModelError, match="no such checkpoint"):
        load(tmp_path / f"net{ending}")
    with pytest.raises(ModelError, match="expected 00000000"):
        load(save(tmp_path / f"net{ending}"), sha256="00000000")
    with pytest.raises(ModelError, match="needs its file"):
        rf.load_model("torchscript" if ending == ".ts" else "torch_export")

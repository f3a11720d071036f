"""Files of torch.export: the same conventions as ONNX, our own networks' numbers, nothing hostile run."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import zipfile
from importlib import import_module

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
    """Export a network."""
    net = (net or Channels()).eval()
    inputs = tuple(torch.zeros(shape if dynamic else (1, *shape[1:])) for shape in SHAPES[net.layout])
    sides = tuple({0: AUTO, x.ndim - 2: AUTO, x.ndim - 1: AUTO} if dynamic else None for x in inputs)
    if len(inputs) > 1 or dynamic:
        sides = (sides,)  # of *images
    torch.export.save(torch.export.export(net, inputs, dynamic_shapes=sides if dynamic else None), path)
    return path


def frames(height=13, width=19, seed=0):
    return list(np.random.default_rng(seed).integers(0, 256, (2, height, width, 3)).astype(np.uint8))


def load(path, **options):
    return rf.load_model(str(path), device="cpu", **options)


@pytest.mark.parametrize("layout", SHAPES)
@pytest.mark.parametrize("channels_last", [False, True])
def test_every_way_in_and_out(tmp_path, layout, channels_last):
    path = save(tmp_path / "net.pt2", Channels(layout, channels_last))
    first, second = frames()
    model = load(path, scaling="0-255")
    np.testing.assert_array_equal(model.predict(first, second), np.stack([first[..., 0], second[..., 2]], 2))
    identity = model.identity()
    assert identity["layout"] == layout
    assert identity["name"] == "torch_export:net"
    assert len(identity["checkpoint"]) == 64


def test_colours_and_range(tmp_path):
    path = save(tmp_path / "net.pt2")
    first, second = (frame / 255.0 for frame in frames())
    flow = load(path, order="bgr", scaling="imagenet").predict(*frames())
    expected = np.stack([(first[..., 2] - 0.406) / 0.225, (second[..., 0] - 0.485) / 0.229], axis=2)
    np.testing.assert_allclose(flow, expected, atol=1e-6)


@pytest.mark.parametrize("several", ["list", "dict"])
def test_the_flow_among_several_outputs(tmp_path, several):
    path = save(tmp_path / "net.pt2", Channels(several=several))
    chosen = {"output": "flow"} if several == "dict" else {}
    first, second = frames()
    np.testing.assert_array_equal(load(path, scaling="0-255", **chosen).predict(first, second)[..., 0], first[..., 0])
    with pytest.raises(ModelError, match="has no flow as output '7'; its outputs are"):
        load(path, output=7).predict(first, second)
    with pytest.raises(ModelError, match=r"shape \(1, 3, 16, 24\) for 1 inputs of 16x24; expected \(1, 2, 16, 24\)"):
        load(path, output="features" if several == "dict" else 0).predict(first, second)


def test_batches_change_nothing_and_keep_their_order(tmp_path):
    path = save(tmp_path / "net.pt2")
    pairs = [frames(*size, seed=i) for i, size in enumerate([(13, 19), (8, 8), (13, 19), (13, 19)])]
    model = load(path, scaling="0-255")
    assert isinstance(model, BatchedFlowModel)
    assert model.net.batched
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


def test_a_network_that_fails_says_on_what(tmp_path):
    path = save(tmp_path / "net.pt2", Channels("concatenated"))
    with pytest.raises(ModelError, match="does not fit; concatenated does") as error:
        load(path, layout="stacked").predict(*frames())
    one_line(error)


def test_raft_gives_the_flow_of_the_torch_adapter(tmp_path):
    pytest.importorskip("torchvision", reason="needs the torch extra")
    original = rf.load_model("raft_small", checkpoint="random", iterations=2, device="cpu")
    images = tuple(torch.zeros(1, 3, 128, 136) for _ in range(2))
    path = tmp_path / "raft.pt2"
    torch.export.save(torch.export.export(original.net, images), path)
    pair = textured_pair(127, 130)
    expected = original.predict(*pair)
    assert np.abs(expected).max() > 0.1
    flow = load(path, scaling="0-255").predict(*pair)
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
    "dunder": edit(MODEL, lambda model: graph(model)["nodes"][0].update(target="torch.ops.aten.__class__.__init__")),
    "dunder overload": edit(MODEL, lambda model: graph(model)["nodes"][0].update(target="torch.ops.aten.add.__init__")),
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


def pickled_module(path):
    torch.save(Channels(), path)


def bomb(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("constants.pkl", "code/x.py", "models/model.json"):
            archive.writestr(f"net/{name}", bytes(2**26))


NO_PROGRAM = {
    "pickled module": (
        pickled_module,
        r"it is not a complete file of torch\.export",
    ),
    "plain pickle": (
        lambda path: path.write_bytes(pickle.dumps(Payload(path.with_name("ran")))),
        "truncated or damaged",
    ),
    "bomb": (bomb, "would unpack to"),
    "html": (lambda path: path.write_text("<html>"), "is a web page"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "cut": (lambda path: path.write_bytes(save(path).read_bytes()[:-200]), "truncated or damaged|not a complete file"),
}


@pytest.mark.parametrize("kind", NO_PROGRAM)
def test_files_that_are_not_programs(tmp_path, kind):
    path = tmp_path / "net.pt2"
    make, says = NO_PROGRAM[kind]
    make(path)
    with pytest.raises(ModelError, match=says) as error:
        load(path)
    one_line(error)
    assert os.listdir(tmp_path) == [path.name]


def test_a_missing_file_and_another_hash(tmp_path):
    with pytest.raises(ModelError, match="no such checkpoint"):
        load(tmp_path / "net.pt2")
    with pytest.raises(ModelError, match="expected 00000000"):
        load(save(tmp_path / "net.pt2"), sha256="00000000")
    with pytest.raises(ModelError, match="needs its file"):
        rf.load_model("torch_export")


TORCHSCRIPT = """
class Sets(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))
        self.training = False

    @torch.jit.export
    def __getstate__(self):
        return (self.weight, self.training)

    @torch.jit.export
    def __setstate__(self, state: tuple[torch.Tensor, bool]):
        written = torch.from_file("{marker}", True, 8)
        print(written.fill_(7).sum())
        self.weight = state[0]
        self.training = state[1]

    def forward(self, first, second):
        return first[:, :2]
"""


def test_torchscript_is_never_read(tmp_path, monkeypatch):
    """PyTorch runs the file's `__setstate__` while it reads it: nothing could be checked before."""
    marker, module = tmp_path / "written", tmp_path / "sets_state.py"
    module.write_text("import torch\n" + TORCHSCRIPT.replace("{marker}", str(marker)))
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "net.ts"
    torch.jit.script(import_module("sets_state").Sets()).save(str(path))
    marker.unlink(missing_ok=True)
    shutil.copy(path, tmp_path / "net.torchscript")
    says = r"TorchScript is not read.*export the network with torch\.export\.save"
    for name in ("net.ts", "net.torchscript"):
        with pytest.raises(UsageError, match=says) as error:
            load(tmp_path / name)
        one_line(error)
    with pytest.raises(UsageError, match=says):
        load("torchscript", checkpoint=str(path))
    assert not marker.exists()
    torch.jit.load(str(path))
    assert marker.exists(), "PyTorch's reader runs nothing, so TorchScript need not be refused"


def test_two_parts_of_one_name_are_refused(tmp_path, monkeypatch):
    """Readers differ in which of the two they take: the one that was checked, or the other."""
    path = save(tmp_path / "net.pt2")
    with zipfile.ZipFile(path) as archive:
        name = next(name for name in archive.namelist() if name.endswith(MODEL))
        content = archive.read(name)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, content)
    with pytest.raises(ModelError, match="not a complete file of torch"):
        load(path)
    path = save(tmp_path / "other.pt2")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"another_root/{MODEL}", content)  # the same part once the root's name is gone
    with pytest.raises(ModelError, match="not a complete file of torch"):
        load(path)

"""Test the colour order, value range, padding and all layouts of ONNX networks with known flow, and malicious files."""

import hashlib
import os

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the onnx extra")
pytest.importorskip("onnxruntime", reason="needs the onnx extra")

import onnxruntime as ort
from onnx import TensorProto, helper

import robustflow as rf
from robustflow.core.errors import AssetError, ModelError, UsageError
from robustflow.models import ModelSpec
from robustflow.models.base import BatchedFlowModel

from ..refusals import refused
from . import onnx_graphs as graphs
from .textures import channel_flow, noise_pair

pytestmark = pytest.mark.usefixtures("quick_workers")

IMAGENET = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])
RANGES = {
    "0-1": lambda values, channel: values / 255,
    "-1-1": lambda values, channel: values / 127.5 - 1,
    "0-255": lambda values, channel: values,
    "imagenet": lambda values, channel: (values / 255 - IMAGENET[0, channel]) / IMAGENET[1, channel],
}


def network(tmp_path, options=None, **graph):
    return rf.load_model(str(graphs.channels(tmp_path / "net.onnx", **graph)), **(options or {}))


@pytest.mark.parametrize("scaling", RANGES)
@pytest.mark.parametrize("order", ["rgb", "bgr"])
def test_colours_and_range_are_converted_as_declared(tmp_path, order, scaling):
    first, second = (frame.astype(np.float64) for frame in noise_pair())
    flow = network(tmp_path, {"order": order, "scaling": scaling}).predict(*noise_pair())
    u, v = (0, 2) if order == "rgb" else (2, 0)  # the network only reads the first and third channels
    expected = np.stack([RANGES[scaling](first[..., u], u), RANGES[scaling](second[..., v], v)], axis=2)
    assert flow.dtype == np.float32
    np.testing.assert_allclose(flow, expected, atol=1e-4 if scaling == "0-255" else 1e-6)


@pytest.mark.parametrize("layout", graphs.WAYS_IN)
@pytest.mark.parametrize("channels_last", [False, True])
def test_every_input_layout_gives_the_same_flow(tmp_path, layout, channels_last):
    model = network(tmp_path, {"scaling": "0-255"}, layout=layout, channels_last=channels_last)
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))
    assert model.identity()["layout"] == layout


@pytest.mark.parametrize(
    ("size", "multiple", "fixed"),
    [((13, 19), 8, None), ((16, 24), 8, None), ((5, 9), 1, None), ((13, 19), 8, (20, 31))],
)
def test_the_border_is_repeated_and_cropped(tmp_path, size, multiple, fixed):
    """The network flips its flow, so that padding errors are visible after cropping."""
    first, second = noise_pair(*size)
    model = network(tmp_path, {"scaling": "0-255", "multiple": multiple}, flip=True, size=fixed or ("h", "w"))
    height, width = size
    target = fixed or tuple(-(-side // multiple) * multiple for side in size)
    above, left = (target[0] - height) // 2, (target[1] - width) // 2
    sides = (above, target[0] - height - above), (left, target[1] - width - left)
    padded = np.pad(channel_flow(first, second), (*sides, (0, 0)), mode="edge")[::-1, ::-1]
    np.testing.assert_array_equal(model.predict(first, second), padded[above:, left:][:height, :width])


@pytest.mark.parametrize("size", [(32, 40), (30, 37)])
def test_a_fixed_size_is_the_largest_and_tiles_help(tmp_path, size):
    model = network(tmp_path, {"scaling": "0-255"}, size=size)
    assert model.identity()["input"]["size"] == list(size)
    tile = "x".join(map(str, size))
    with pytest.raises(ModelError, match=rf"up to {tile}, not 50x41: export it .* or .* -O tile={tile}"):
        model.predict(*noise_pair(50, 41))
    tiled = rf.load_model(str(tmp_path / "net.onnx"), scaling="0-255", tile=tile)
    np.testing.assert_allclose(tiled.predict(*noise_pair(50, 41)), channel_flow(*noise_pair(50, 41)), atol=1e-3)


@pytest.mark.parametrize("batch", ["n", 1])
def test_batches_change_nothing_and_keep_their_order(tmp_path, batch):
    model = network(tmp_path, {"scaling": "0-255"}, batch=batch)
    pairs = [noise_pair(*size, seed=i) for i, size in enumerate([(13, 19), (8, 8), (13, 19), (13, 19)])]
    together = model.predict_batch(*zip(*pairs, strict=True))
    assert isinstance(model, BatchedFlowModel)
    for flow, pair in zip(together, pairs, strict=True):
        np.testing.assert_array_equal(flow, channel_flow(*pair))
    assert model.predict_batch([], []) == []
    if batch == "n":
        same = [0, 2, 3]
        at_once = model.run(*zip(*(pairs[i] for i in same), strict=True))  # as on a GPU
        np.testing.assert_array_equal(at_once, [together[i] for i in same])


@pytest.mark.parametrize("kind", [TensorProto.FLOAT16, TensorProto.DOUBLE])
def test_half_and_double_precision_networks_return_float32_flow(tmp_path, kind):
    flow = network(tmp_path, {"scaling": "0-255"}, kind=kind).predict(*noise_pair())
    assert flow.dtype == np.float32
    np.testing.assert_array_equal(flow, channel_flow(*noise_pair()))


def test_flow_is_found_among_several_outputs(tmp_path):
    more = ("features", "7")
    first, second = noise_pair()
    model = network(tmp_path, {"scaling": "0-255"}, more_outputs=more)
    assert model.identity()["output"] == "flow"
    np.testing.assert_array_equal(model.predict(first, second)[..., 0], first[..., 0])
    with pytest.raises(UsageError, match="unknown output of the network 'flwo': did you mean 'flow'"):
        network(tmp_path, {"output": "flwo"}, more_outputs=more)
    wrong = network(tmp_path, {"output": 7}, more_outputs=more)
    with pytest.raises(
        ModelError, match=r"shape \(1, 3, 16, 24\) for 1 inputs of 16x24; expected \(1, 2, 16, 24\) or \(1, 16, 24, 2\)"
    ):
        wrong.predict(first, second)


@pytest.mark.parametrize("kind", ["INT32", "BOOL", "STRING"])
def test_output_without_floating_point_values_is_refused(tmp_path, kind):
    inputs = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 6, "h", "w"])]
    nodes = [
        helper.make_node("Slice", ["x", "start", "end", "axis"], ["uv"]),
        helper.make_node("Cast", ["uv"], ["flow"], to=TensorProto.DataType.Value(kind)),
    ]
    constants = [
        helper.make_tensor(name, TensorProto.INT64, [1], [value])
        for name, value in (("start", 0), ("end", 2), ("axis", 1))
    ]
    outputs = [helper.make_tensor_value_info("flow", TensorProto.DataType.Value(kind), None)]
    model = rf.load_model(str(graphs.save(tmp_path / "net.onnx", inputs, nodes, outputs, constants)))
    with refused(ModelError, "the network's output flow is .*; export it with a floating-point flow"):
        model.predict(*noise_pair())


def test_network_without_outputs_is_refused(tmp_path):
    inputs = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 6, "h", "w"])]
    path = graphs.save(tmp_path / "net.onnx", inputs, [helper.make_node("Identity", ["x"], ["y"])], [])
    with refused(ModelError, "the network has no outputs"):
        rf.load_model(str(path))


def test_inputs_option_sets_the_order_of_the_frames(tmp_path):
    first, second = noise_pair()
    model = network(tmp_path, {"inputs": "next, previous", "scaling": "0-255"}, names=("previous", "next"))
    np.testing.assert_array_equal(model.predict(first, second), np.stack([second[..., 0], first[..., 2]], 2))
    with pytest.raises(UsageError, match="unknown input of the network 'nest': did you mean 'next'"):
        network(tmp_path, {"inputs": "nest,previous"}, names=("previous", "next"))
    with pytest.raises(ModelError, match=r"inputs are previous .*, next .*, but only next would be used"):
        network(tmp_path, {"inputs": "next"}, names=("previous", "next"))


def one_input(path, shape, kind=TensorProto.FLOAT, count=1):
    inputs = [helper.make_tensor_value_info(f"x{i}", kind, shape) for i in range(count)]
    outputs = [helper.make_tensor_value_info("flow", kind, shape)]
    return graphs.save(path, inputs, [helper.make_node("Identity", ["x0"], ["flow"])], outputs)


@pytest.mark.parametrize(
    ("shape", "count", "says"),
    [
        ([1, 4, 8, 8], 1, r"inputs are x0 \(1, 4, 8, 8\): expected two inputs \(N, 3, H, W\)"),
        (["n", "h", "w", 3], 2, r"expects frames of \?x3"),
        ([1, 3, 8, 8], 3, r"x2 \(1, 3, 8, 8\): expected two"),
        ([4, 6, 8, 8], 1, r"x0 \(4, 6, 8, 8\): expected a dynamic batch size or a batch size of 1"),
        ([1, 6, 2**20, 2**20], 1, "expects frames of 1048576x1048576"),
    ],
)
def test_network_whose_inputs_are_no_pair_is_refused(tmp_path, shape, count, says):
    path = one_input(tmp_path / "net.onnx", shape, count=count)
    with refused(ModelError, says):
        rf.load_model(str(path)).predict(*noise_pair())


def test_an_input_of_unknown_shape_asks_for_the_layout(tmp_path):
    path = one_input(tmp_path / "net.onnx", None)
    with pytest.raises(ModelError, match=r"x0 \(unknown shape\): several .* one of stacked, concatenated"):
        rf.load_model(str(path))
    assert rf.load_model(str(path), layout="concatenated").identity()["layout"] == "concatenated"
    path = graphs.channels(tmp_path / "six.onnx", layout="concatenated")
    with pytest.raises(ModelError, match="layout=stacked does not match; concatenated does"):
        rf.load_model(str(path), layout="stacked")


def test_network_with_integer_inputs_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"input x0 is tensor\(int32\); expected one of tensor\(float\)"):
        rf.load_model(str(one_input(tmp_path / "net.onnx", ["n", 6, "h", "w"], TensorProto.INT32)))


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"order": "gbr"}, UsageError, "unknown order 'gbr': did you mean 'rgb'"),
        ({"scaling": "0-2"}, UsageError, "unknown scaling '0-2'"),
        ({"layout": "both"}, UsageError, "unknown layout 'both'"),
        ({"multiple": 0}, UsageError, "multiple must be an integer from 1 to 1024"),
        ({"threads": 0}, UsageError, "threads must be an integer from 1 to 1024"),
        ({"device": "gpu"}, UsageError, "unknown device 'gpu' for onnxruntime"),
        ({"sha256": "0" * 64}, ModelError, "instead of 0000"),
        ({"order_": "rgb"}, UsageError, "unknown option of model 'onnx' 'order_': did you mean 'order'"),
        ({"checkpoint": "net.onnx"}, UsageError, "is itself the network; omit the checkpoint"),
    ],
)
def test_invalid_options_of_onnx_are_refused(tmp_path, options, error, says):
    with pytest.raises(error, match=says):
        network(tmp_path, options)


@pytest.mark.skipif("CUDAExecutionProvider" in ort.get_available_providers(), reason="this onnxruntime has CUDA")
def test_missing_cuda_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"no CUDA support for device 'cuda:1': install onnxruntime-gpu"):
        network(tmp_path, {"device": "cuda:1"})


def test_identity_names_the_file_by_its_hash_and_what_changes_the_numbers(tmp_path):
    path = graphs.channels(tmp_path / "net.onnx")
    plain = rf.load_model(str(path)).identity()
    assert plain == {
        "name": "onnx:net",
        "checkpoint": hashlib.sha256(path.read_bytes()).hexdigest(),
        "layout": "pair",
        "inputs": ["image1", "image2"],
        "output": "flow",
        "threads": 1,
        "input": {
            "order": "rgb",
            "mean": [0.0, 0.0, 0.0],
            "scale": 1 / 255,
            "fit": "pad",
            "multiple": 8,
            "padding": "replicate",
            "vertical": "both",
        },
        "device": "cpu",
        "library": f"onnxruntime {ort.__version__}",
    }
    others = [{"order": "bgr"}, {"scaling": "imagenet"}, {"multiple": 16}, {"inputs": "image2,image1"}, {"threads": 2}]
    assert all(rf.load_model(str(path), **options).identity() != plain for options in others)
    (tmp_path / "elsewhere").mkdir()
    moved = path.rename(tmp_path / "elsewhere" / "net.onnx")
    spec = ModelSpec(str(moved))
    assert spec.identity(spec.load()) == {**plain, "options": {}}


@pytest.mark.parametrize("library", ["onnx", "onnxruntime"])
def test_without_the_extra_the_message_names_it(tmp_path, monkeypatch, library):
    from importlib.util import find_spec

    monkeypatch.setattr("robustflow.core.plugins.find_spec", lambda name: None if name == library else find_spec(name))
    with pytest.raises(AssetError, match=rf"needs {library}, which is not installed: pip install 'robustflow\[onnx\]'"):
        network(tmp_path)


def giant_weight():
    weight = TensorProto(name="x0", data_type=TensorProto.FLOAT, dims=[2**40], raw_data=b"1234")
    outputs = [helper.make_tensor_value_info("flow", TensorProto.FLOAT, [2**40])]
    graph = helper.make_graph([helper.make_node("Identity", ["x0"], ["flow"])], "n", [], outputs, [weight])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9).SerializeToString()


HOSTILE = {
    "html": (lambda good: b"<!DOCTYPE html><html>", "is a web page"),
    "lfs": (lambda good: b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
    "empty": (lambda good: b"", "is empty"),
    "cut": (lambda good: good[: len(good) // 2], "truncated or damaged"),
    "zip": (lambda good: b"PK\x03\x04" + bytes(100), "truncated or damaged"),
    "noise": (lambda good: np.random.default_rng(0).bytes(1000), "truncated or damaged"),
    "another protobuf": (lambda good: b"\x08\x09", r"not an ONNX network"),
    "giant weight": (lambda good: giant_weight(), "onnxruntime .* cannot load it"),
    "unknown operator": (
        lambda good: good.replace(b"Gather", b"Gathxr"),
        "cannot load it .*Gathxr.*update onnxruntime",
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_onnx_files_are_refused(tmp_path, capfd, kind):
    path = graphs.channels(tmp_path / "net.onnx")
    make, says = HOSTILE[kind]
    path.write_bytes(make(path.read_bytes()))
    with refused(ModelError, says):
        rf.load_model(str(path))
    assert capfd.readouterr() == ("", "")


def test_network_that_requests_terabytes_fails_with_one_error(tmp_path):
    """A file of a few bytes that requests 4 TB of memory while the network runs."""
    inputs = [helper.make_tensor_value_info(f"x{i}", TensorProto.FLOAT, ["n", 3, "h", "w"]) for i in range(2)]
    outputs = [helper.make_tensor_value_info("flow", TensorProto.FLOAT, ["a"])]
    nodes = [helper.make_node("ConstantOfShape", ["size"], ["flow"])]
    constant = helper.make_tensor("size", TensorProto.INT64, [1], [2**40])
    path = graphs.save(tmp_path / "net.onnx", inputs, nodes, outputs, [constant])
    with refused(ModelError, "the network failed on x0"):
        rf.load_model(str(path)).predict(*noise_pair())


def test_weights_beside_the_file_count_for_its_identity(tmp_path):
    path = graphs.with_weights_beside(tmp_path / "net.onnx", "net.data")
    flow = np.arange(32, dtype=np.float32).reshape(2, 4, 4)
    (tmp_path / "net.data").write_bytes(flow.tobytes())
    model = rf.load_model(str(path))
    np.testing.assert_array_equal(model.predict(*noise_pair(4, 4)), flow.transpose(1, 2, 0))
    digest = hashlib.sha256(flow.tobytes()).hexdigest()
    assert model.identity()["external_data"] == {"net.data": digest}
    (tmp_path / "net.data").unlink()
    with pytest.raises(ModelError, match=r"its weights 'net\.data' cannot be read \(No such file"):
        rf.load_model(str(path))
    (tmp_path / "net.data").write_bytes(flow.tobytes()[:-1])
    with pytest.raises(ModelError, match="cannot load it"):
        rf.load_model(str(path))


@pytest.mark.parametrize("location", ["w\0", 5000 * "x"], ids=["null character", "too long"])
def test_weights_under_an_impossible_name_are_refused(tmp_path, location):
    path = graphs.with_weights_beside(tmp_path / "net.onnx", location)
    with refused(ModelError, r"net\.onnx: its weights '.{2,200}' cannot be read \("):
        rf.load_model(str(path))


@pytest.mark.parametrize("location", ["../secret", "{absolute}", "link", "sub/../../secret", ""])
def test_weights_outside_its_folder_are_refused(tmp_path, location):
    (tmp_path / "secret").write_bytes(bytes(128))
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path / "secret")
    location = location.format(absolute=tmp_path / "secret")
    path = graphs.with_weights_beside(folder / "net.onnx", location)
    with refused(ModelError, r"it reads weights from '.*', outside its own folder"):
        rf.load_model(str(path))


def test_weights_in_a_pipe_are_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "weights")
    path = graphs.with_weights_beside(tmp_path / "net.onnx", "weights")
    with pytest.raises(ModelError, match="its weights 'weights' are not a regular file"):
        rf.load_model(str(path))


def test_a_missing_file_comes_before_a_missing_library(tmp_path, monkeypatch):
    with pytest.raises(ModelError, match=r"model 'onnx' needs a file"):
        rf.load_model("onnx")
    monkeypatch.setattr("robustflow.core.plugins.find_spec", lambda name: None)
    with pytest.raises(ModelError, match="no such file; pass the path of the exported network"):
        rf.load_model(str(tmp_path / "net.onnx"))

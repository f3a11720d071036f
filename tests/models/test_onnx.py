"""ONNX networks with known flow: colours, value range, padding, layouts; hostile files; limits of memory and time."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the onnx extra")
pytest.importorskip("onnxruntime", reason="needs the onnx extra")

import onnxruntime as ort
from onnx import TensorProto, helper

import robustflow as rf
from robustflow.core.errors import AssetError, ModelError, UsageError
from robustflow.models import ModelRef
from robustflow.models.protocols import BatchedFlowModel

from ..refusals import refusal
from . import onnx_graphs as graphs
from .textures import channel_flow, noise_pair

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


def test_a_fixed_size_is_the_largest_and_tiles_help(tmp_path):
    model = network(tmp_path, {"scaling": "0-255"}, size=(30, 37))
    assert model.identity()["input"]["size"] == [30, 37]
    refusal(lambda: model.predict(*noise_pair(50, 41)), ModelError, "50x41")
    tiled = rf.load_model(str(tmp_path / "net.onnx"), scaling="0-255", tile="30x37")
    np.testing.assert_allclose(tiled.predict(*noise_pair(50, 41)), channel_flow(*noise_pair(50, 41)), atol=1e-3)


@pytest.mark.parametrize("batch", ["n", 1])
def test_batches_change_nothing_and_keep_their_order(tmp_path, batch):
    model = network(tmp_path, {"scaling": "0-255"}, batch=batch)
    pairs = [noise_pair(*size, seed=i) for i, size in enumerate([(13, 19), (8, 8), (13, 19), (13, 19)])]
    together = model.predict_batch(*zip(*pairs, strict=True))
    assert isinstance(model, BatchedFlowModel)
    for flow, pair in zip(together, pairs, strict=True):
        np.testing.assert_array_equal(flow, channel_flow(*pair))
    if batch == "n":
        at_once = model.run(*zip(*(pairs[i] for i in (0, 2, 3)), strict=True))  # as on a GPU
        np.testing.assert_array_equal(at_once, [together[i] for i in (0, 2, 3)])


@pytest.mark.parametrize("kind", ["float16", "double"])
def test_half_and_double_precision_networks_return_float32_flow(tmp_path, kind):
    flow = network(tmp_path, {"scaling": "0-255"}, kind=kind).predict(*noise_pair())
    assert flow.dtype == np.float32
    np.testing.assert_array_equal(flow, channel_flow(*noise_pair()))


def test_outputs_and_inputs_are_chosen_by_name(tmp_path):
    first, second = noise_pair()
    more = {"more_outputs": ("features", "7"), "names": ("previous", "next")}
    model = network(tmp_path, {"scaling": "0-255"}, **more)
    assert model.identity()["output"] == "flow"
    np.testing.assert_array_equal(model.predict(first, second)[..., 0], first[..., 0])
    swapped = network(tmp_path, {"inputs": "next, previous", "scaling": "0-255"}, **more)
    np.testing.assert_array_equal(swapped.predict(first, second), np.stack([second[..., 0], first[..., 2]], 2))
    refusal(lambda: network(tmp_path, {"output": 7}, **more).predict(first, second), ModelError, "(1, 3, 16, 24)")
    for options, error, culprit in (
        ({"output": "flwo"}, UsageError, "flwo"),
        ({"inputs": "nest,previous"}, UsageError, "nest"),
        ({"inputs": "next"}, ModelError, tmp_path / "net.onnx"),
    ):
        refusal(lambda options=options: network(tmp_path, options, **more), error, culprit)


def one_input(path, shape, kind="float", count=1, to=None):
    """Save a network whose output is its first input, or two channels of it in a different type."""
    inputs = ", ".join(f"{kind}[{shape}] x{i}" for i in range(count))
    if to is None:
        return graphs.save(path, inputs, f"{kind}[{shape}] flow", "flow = Identity (x0)")
    nodes = f"uv = Slice (x0, start, end, axis) flow = Cast <to={TensorProto.DataType.Value(to.upper())}> (uv)"
    constants = "int64[1] start = {0}, int64[1] end = {2}, int64[1] axis = {1}"
    return graphs.save(path, inputs, f"{to}[] flow", nodes, constants)


@pytest.mark.parametrize(
    ("shape", "count", "culprit"),
    [
        ("1,4,8,8", 1, None),
        ("n,h,w,3", 2, "?x3"),
        ("1,3,8,8", 3, None),
        ("1,3,8,8", 2, None),  # the second frame is not read
        ("4,6,8,8", 1, None),
        ("1,6,1048576,1048576", 1, "1048576x1048576"),
        ("", 1, None),
    ],
)
def test_network_whose_inputs_are_no_pair_is_refused(tmp_path, shape, count, culprit):
    path = one_input(tmp_path / "net.onnx", shape, count=count)
    refusal(lambda: rf.load_model(str(path)), ModelError, culprit or path)


def test_the_layout_of_an_input_of_unknown_shape_is_declared(tmp_path):
    path = one_input(tmp_path / "net.onnx", "")
    assert rf.load_model(str(path), layout="concatenated").identity()["layout"] == "concatenated"
    path = graphs.channels(tmp_path / "six.onnx", layout="concatenated")
    refusal(lambda: rf.load_model(str(path), layout="stacked"), ModelError, path)


def test_networks_of_integers_or_without_outputs_are_refused(tmp_path):
    path = one_input(tmp_path / "net.onnx", "n,6,h,w", "int32")
    refusal(lambda: rf.load_model(str(path)), ModelError, path)
    for kind in ("int32", "bool", "string"):
        one_input(path, "1,6,h,w", to=kind)
        refusal(lambda: rf.load_model(str(path)).predict(*noise_pair()), ModelError, "flow")
    graphs.save(path, "float[1,6,h,w] x", "", "y = Identity (x)")
    refusal(lambda: rf.load_model(str(path)), ModelError, path)


@pytest.mark.parametrize(
    ("options", "error", "culprit"),
    [
        ({"order": "gbr"}, UsageError, "gbr"),
        ({"scaling": "0-2"}, UsageError, "0-2"),
        ({"layout": "both"}, UsageError, "both"),
        ({"multiple": 0}, UsageError, "multiple"),
        ({"threads": 0}, UsageError, "threads"),
        ({"device": "gpu"}, UsageError, "gpu"),
        ({"memory_limit": 0}, UsageError, "memory_limit"),
        ({"time_limit": -1}, UsageError, "time_limit"),
        ({"time_limit": "long"}, UsageError, "time_limit"),
        ({"order_": "rgb"}, UsageError, "order_"),
        ({"checkpoint": "net.onnx"}, UsageError, "checkpoint"),
        ({"sha256": "0" * 64}, ModelError, None),
    ],
)
def test_invalid_options_of_onnx_are_refused(tmp_path, options, error, culprit):
    refusal(lambda: network(tmp_path, options), error, culprit or tmp_path / "net.onnx")


@pytest.mark.skipif("CUDAExecutionProvider" in ort.get_available_providers(), reason="this onnxruntime has CUDA")
def test_missing_cuda_is_refused(tmp_path):
    refusal(lambda: network(tmp_path, {"device": "cuda:1"}), ModelError, "cuda:1")


def test_identity_names_the_file_by_its_hash_and_what_changes_the_numbers(tmp_path):
    path = graphs.channels(tmp_path / "net.onnx")
    plain = rf.load_model(str(path)).identity()
    convention = {"order": "rgb", "mean": [0.0, 0.0, 0.0], "scale": 1 / 255, "fit": "pad", "multiple": 8}
    assert plain == {
        "name": "onnx:net",
        "checkpoint": hashlib.sha256(path.read_bytes()).hexdigest(),
        "layout": "pair",
        "inputs": ["image1", "image2"],
        "output": "flow",
        "threads": 1,
        "input": {**convention, "padding": "replicate", "vertical": "both"},
        "device": "cpu",
        "library": f"onnxruntime {ort.__version__}",
    }
    others = [{"order": "bgr"}, {"scaling": "imagenet"}, {"multiple": 16}, {"inputs": "image2,image1"}, {"threads": 2}]
    assert all(rf.load_model(str(path), **options).identity() != plain for options in others)
    (tmp_path / "elsewhere").mkdir()
    spec = ModelRef.parse(str(path.rename(tmp_path / "elsewhere" / "net.onnx")))
    assert spec.identity(spec.load()) == {**plain, "options": {}}


def test_a_missing_library_is_named_after_a_missing_file(tmp_path, monkeypatch):
    refusal(lambda: rf.load_model("onnx"), ModelError, "onnx")
    missing = []
    monkeypatch.setattr("robustflow.core.plugins.find_spec", lambda name: None if name in missing else find_spec(name))
    for library in ("onnx", "onnxruntime"):
        missing[:] = [library]
        assert "robustflow[onnx]" in str(refusal(lambda: network(tmp_path), AssetError, library))
        absent = tmp_path / "absent.onnx"
        refusal(lambda path=absent: rf.load_model(str(path)), ModelError, absent)


def giant_weight():
    weight = TensorProto(name="x0", data_type=TensorProto.FLOAT, dims=[2**40], raw_data=b"1234")
    outputs = [helper.make_tensor_value_info("flow", TensorProto.FLOAT, [2**40])]
    graph = helper.make_graph([helper.make_node("Identity", ["x0"], ["flow"])], "n", [], outputs, [weight])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9).SerializeToString()


HOSTILE = {
    "html": lambda good: b"<!DOCTYPE html><html>",
    "lfs": lambda good: b"version https://git-lfs.github.com/spec/v1\n",
    "empty": lambda good: b"",
    "cut": lambda good: good[: len(good) // 2],
    "zip": lambda good: b"PK\x03\x04" + bytes(100),
    "noise": lambda good: np.random.default_rng(0).bytes(1000),
    "another protobuf": lambda good: b"\x08\x09",
    "giant weight": lambda good: giant_weight(),
    "unknown operator": lambda good: good.replace(b"Gather", b"Gathxr"),
}


@pytest.mark.parametrize("make", HOSTILE.values(), ids=HOSTILE)
def test_hostile_onnx_files_are_refused(tmp_path, capfd, make):
    path = graphs.channels(tmp_path / "net.onnx")
    path.write_bytes(make(path.read_bytes()))
    refusal(lambda: rf.load_model(str(path)), ModelError, path)
    assert capfd.readouterr() == ("", "")


def test_weights_beside_the_file_count_for_its_identity(tmp_path):
    path = graphs.with_weights_beside(tmp_path / "net.onnx", "net.data")
    flow = np.arange(32, dtype=np.float32).reshape(2, 4, 4)
    (tmp_path / "net.data").write_bytes(flow.tobytes())
    model = rf.load_model(str(path))
    np.testing.assert_array_equal(model.predict(*noise_pair(4, 4)), flow.transpose(1, 2, 0))
    assert model.identity()["external_data"] == {"net.data": hashlib.sha256(flow.tobytes()).hexdigest()}
    (tmp_path / "net.data").write_bytes(flow.tobytes()[:-1])
    refusal(lambda: rf.load_model(str(path)), ModelError, path)
    (tmp_path / "net.data").unlink()
    refusal(lambda: rf.load_model(str(path)), ModelError, path)


@pytest.mark.parametrize(
    "location", ["w\0", 5000 * "x", "../secret", "{absolute}", "link", "sub/../../secret", "", "pipe"]
)
def test_weights_outside_its_folder_or_under_an_impossible_name_are_refused(tmp_path, location):
    (tmp_path / "secret").write_bytes(bytes(128))
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path / "secret")
    os.mkfifo(folder / "pipe")  # not waited for
    path = graphs.with_weights_beside(folder / "net.onnx", location.format(absolute=tmp_path / "secret"))
    refusal(lambda: rf.load_model(str(path)), ModelError, path)


_PREDICT = """
import resource, signal, sys
import numpy as np
import robustflow as rf
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in what a shell runs in the background
model = rf.load_model(sys.argv[1])
print("loaded", flush=True)
frame = np.zeros((16, 24, 3), np.uint8)
try:
    model.predict(frame, frame)
except rf.RobustFlowError as error:
    print(type(error).__name__, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def _started(network: Path) -> subprocess.Popen[str]:
    """Start a script, without a guard for child processes, that loads a network and predicts."""
    script = network.with_name("predict.py")
    script.write_text(_PREDICT)
    command = [sys.executable, script, network]
    begun = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert begun.stdout is not None
    assert begun.stdout.readline() == "loaded\n"
    return begun


def test_network_that_requests_gigabytes_is_refused_before_it_gets_them(tmp_path):
    path = graphs.hungry(tmp_path / "net.onnx")
    assert path.stat().st_size < 500
    kind, peak = _started(path).communicate(timeout=100)[0].split()
    assert kind == "ModelError"
    assert int(peak) < 1_000_000  # KiB
    limited = rf.load_model(str(path), memory_limit=0.5)
    refusal(lambda: limited.predict(*noise_pair()), ModelError, "onnx:net")
    model = network(tmp_path, {"memory_limit": 1, "scaling": "0-255"})
    np.testing.assert_array_equal(model.predict(*noise_pair()), channel_flow(*noise_pair()))


def test_network_that_never_ends_is_refused_after_the_time_limit_and_can_be_called_again(tmp_path):
    path = graphs.endless(tmp_path / "net.onnx")
    assert path.stat().st_size < 500
    model = rf.load_model(str(path), time_limit=1)
    for _ in range(2):
        refusal(lambda: model.predict(*noise_pair()), ModelError, path)


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_signal_ends_a_network_that_never_ends(tmp_path, stop):
    begun = _started(graphs.endless(tmp_path / "net.onnx"))
    children = [int(pid) for pid in Path(f"/proc/{begun.pid}/task/{begun.pid}/children").read_text().split()]
    assert children
    begun.send_signal(stop)
    begun.communicate(timeout=120)
    end = time.monotonic() + 60
    while running := [pid for pid in children if _runs(pid)]:
        assert time.monotonic() < end, f"{running} still run"
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    try:
        return "zombie" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False

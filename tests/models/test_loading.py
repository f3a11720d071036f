"""Models are loaded by name, by module and attribute, or from a folder; what is missing is reported at once."""

import json
import subprocess
import sys
from functools import partial
from importlib import util
from pathlib import Path

import numpy as np
import pytest

from robustflow import load_model, write_flow
from robustflow.core.errors import AssetError, DataError, ModelError, UsageError
from robustflow.models import FlowLookup, FlowModel, FunctionModel, ModelRef
from robustflow.models.calls import predict_checked
from robustflow.models.objects import as_model
from robustflow.testing import ZeroFlow

from ..refusals import refusal

RANDOM = {"checkpoint": "random"}
FRAME = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)

SOURCE = """
import numpy as np

def still(a, b):
    return np.zeros((*a.shape[:2], 2), np.float32)

class Model:
    def __init__(self, value=1.0):
        self.value = value
    def predict(self, a, b):
        return np.full((*a.shape[:2], 2), self.value, np.float32)

built = Model(7.0)

def factory(value=3.0):
    return Model(value)

class Broken:
    def __init__(self):
        raise RuntimeError("weights are missing")

class Script:
    def __init__(self):
        raise SystemExit(2)

number = 5
"""


@pytest.fixture
def module(tmp_path, monkeypatch, request):
    name = f"users_{abs(hash(request.node.name)) % 10**8}"
    (tmp_path / f"{name}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    return name


@pytest.mark.parametrize(
    ("attribute", "options", "value"),
    [
        ("still", {}, 0.0),
        ("Model", {}, 1.0),
        ("Model", {"value": 2.5}, 2.5),
        ("built", {}, 7.0),
        ("built.predict", {}, 7.0),
        ("factory", {}, 3.0),
        ("factory", {"value": 4.0}, 4.0),
    ],
)
def test_model_is_loaded_from_module_and_attribute(module, attribute, options, value):
    model = load_model(f"{module}:{attribute}", **options)
    assert isinstance(model, FlowModel)
    assert (model.predict(FRAME, FRAME) == value).all()


@pytest.mark.parametrize(
    ("name", "options", "error", "culprit"),
    [
        ("{module}:Modell", {}, UsageError, "Modell"),
        ("{module}:Model", {"valu": 1}, UsageError, "valu"),
        ("{module}:built", {"value": 1}, UsageError, "value"),
        ("{module}:Broken", {}, ModelError, "{module}:Broken"),
        ("{module}:Script", {}, ModelError, "{module}:Script"),
        ("{module}:number", {}, ModelError, "model '{module}:number'"),
        ("tools/net.py:Model", {}, UsageError, "tools/net.py:Model"),
        ("nowhere/flows", {}, UsageError, "nowhere/flows"),
        ("nowhere.ckpt", {}, UsageError, "nowhere.ckpt"),
        (__file__, {}, UsageError, __file__),
        ("net.ts", {}, UsageError, "net.ts"),
        ("", {}, UsageError, "model"),
        ("diss", {}, UsageError, "diss"),
        ("dis", {"presset": "fast"}, UsageError, "presset"),
        ("dis", {"preset": "slow"}, UsageError, "slow"),
        ("dis", {"device": "cuda"}, UsageError, "--device"),
        ("farneback", {"precision": "bf16"}, UsageError, "--precision"),
        ("dis_rgb", {"checkpoint": "things"}, UsageError, "--checkpoint"),
        ("precomputed", {}, UsageError, "folder"),
        ("dis_rgb", {"operating_point": 5}, UsageError, "5"),
        # options with which OpenCV would crash
        *(("farneback", {"winsize": value}, UsageError, "winsize") for value in (-3, 0, 1.5)),
        *(("farneback", {"levels": value}, UsageError, "levels") for value in ("three", -1, True)),
        *(("farneback", {"pyr_scale": value}, UsageError, "pyr_scale") for value in (1, "half")),
        *(("farneback", {"poly_sigma": value}, UsageError, "poly_sigma") for value in (0.0, float("nan"))),
        *(("farneback", {name: 0}, UsageError, name) for name in ("iterations", "poly_n")),
        ("tiny", {"runtime": "onnx"}, UsageError, "onnx"),
        *(
            ("tiny", {"runtime": "numpy", **options}, UsageError, "runtime")
            for options in ({"device": "cuda"}, {"precision": "bf16"}, {"checkpoint": "random"})
        ),
        ("arflow", RANDOM | {"size": "100x200"}, UsageError, "100x200"),
        ("arflow", RANDOM | {"iterations": 12}, UsageError, "iterations"),
        ("arflow", RANDOM | {"sha256": "12345678"}, UsageError, "sha256"),
        *((name, RANDOM | {"iterations": 0}, UsageError, "iterations") for name in ("brightflow", "samflow_t")),
        ("upflow", RANDOM | {"align_corners": "no"}, UsageError, "align_corners"),
        *(("upflow", RANDOM | {"mask_threshold": value}, UsageError, "mask_threshold") for value in ("high", 1.5)),
        *(("flowdiffuser", RANDOM | {"seed": value}, UsageError, "seed") for value in ("first", True)),
        ("flowdiffuser", RANDOM | {"vertical": "top"}, UsageError, "vertical"),
        ("~nobody_here/net.onnx", {}, DataError, "~nobody_here/net.onnx"),
        ("~nobody_here/flows", {}, DataError, "~nobody_here/flows"),
        ("precomputed", {"folder": "~nobody_here"}, DataError, "~nobody_here"),
        ("raft_small", {"checkpoint": "~nobody_here/raft.pth"}, DataError, "~nobody_here/raft.pth"),
        ("net:" + 300 * "x", {}, DataError, f"net:{56 * 'x'}..."),
    ],
)
def test_unloadable_models_are_refused(module, name, options, error, culprit):
    name, culprit = (text.format(module=module) for text in (name, culprit))
    refusal(lambda: load_model(name, **options), error, culprit)


def test_module_that_cannot_be_imported_is_refused(tmp_path, monkeypatch):
    (tmp_path / "script_for_test.py").write_text("import sys\nsys.exit(2)\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("script_for_test", "no_such_module_here"):
        refusal(partial(load_model, f"{name}:Model"), UsageError, f"{name}:Model")


@pytest.mark.parametrize(
    ("name", "options"), [("~nobody_here/net.onnx", ()), ("raft_small", (("checkpoint", "~nobody_here/raft.pth"),))]
)
def test_a_path_of_an_unknown_user_is_refused_before_loading(name, options):
    refusal(ModelRef.parse(name, options).preflight, DataError, dict(options).get("checkpoint", name))


def test_objects_classes_and_functions_are_models():
    model = ZeroFlow()
    assert as_model(model, "it") is model
    assert isinstance(as_model(ZeroFlow, "it"), ZeroFlow)
    assert isinstance(as_model(lambda a, b: None, "it"), FunctionModel)
    refusal(lambda: as_model(3, "it"), ModelError, "it")


def test_folder_of_flows_is_a_model(tmp_path):
    flow = np.linspace(-5, 5, 64 * 96 * 2, dtype=np.float32).reshape(64, 96, 2)
    for folder, suffix, values in (("clean", "flo", flow), ("fog_2", "pfm", flow + 1)):
        (tmp_path / folder / "scene").mkdir(parents=True)
        write_flow(tmp_path / folder / "scene" / f"a.{suffix}", values)
    known = np.ones((64, 96), bool)
    known[3, 4] = False
    (tmp_path / "snow_1" / "scene").mkdir(parents=True)
    write_flow(tmp_path / "snow_1" / "scene" / "a.flo", flow, known)

    model = load_model(tmp_path)
    assert isinstance(model, FlowLookup)
    np.testing.assert_array_equal(model.lookup("scene/a", "clean", 0), flow)
    np.testing.assert_array_equal(model.lookup("scene/a", "fog", 2), flow + 1)
    assert (np.isnan(model.lookup("scene/a", "snow", 1)).any(axis=2) == ~known).all()
    refusal(lambda: model.lookup("scene/a", "fog", 3), ModelError, tmp_path)


def test_the_identity_of_a_folder_is_that_of_its_files_however_they_are_reached(tmp_path):
    (tmp_path / "flows" / "clean").mkdir(parents=True)
    (tmp_path / "flows" / "clean" / "clip").symlink_to(tmp_path / "clip")
    (tmp_path / "clip").mkdir()
    (tmp_path / "clip" / "loop").symlink_to(tmp_path / "flows")
    (tmp_path / "here").symlink_to(tmp_path / "flows")
    identities = [ModelRef.parse(str(tmp_path / "flows")).load().identity()["files"]]
    for value in (0.0, 1.0):
        write_flow(tmp_path / "clip" / "1.flo", np.full((4, 4, 2), value, np.float32))
        model = load_model(str(tmp_path / "flows"))
        assert model.lookup("clip/1", "clean", 0).max() == value
        assert load_model(str(tmp_path / "here")).identity() == model.identity()
        identities.append(model.identity()["files"])
    assert len(set(identities)) == 3


def test_flows_whose_names_are_not_utf_8_have_an_identity(tmp_path):
    (tmp_path / "clean").mkdir()
    before = load_model(str(tmp_path)).identity()
    (tmp_path / "clean" / "caf\udce9.flo").write_bytes(b"")
    assert load_model(str(tmp_path)).identity() != before


def test_wrong_folder_of_precomputed_flows_is_refused(tmp_path):
    (tmp_path / "clean").mkdir()
    inner = tmp_path / "clean"
    refusal(lambda: load_model("precomputed", folder=str(inner)), ModelError, inner)
    refusal(lambda: load_model(str(tmp_path), device="cpu"), UsageError, "device")


WANDERS = """
import os
import numpy as np

os.chdir("imported")

class Model:
    def __init__(self):
        os.chdir("built")

    def predict(self, a, b):
        os.chdir("predicted")
        return np.zeros((*a.shape[:2], 2), np.float32)
"""


def test_a_model_that_changes_the_working_folder_does_not_change_the_paths_of_a_run(tmp_path, monkeypatch):
    (tmp_path / "wanders.py").write_text(WANDERS)
    for name in ("imported", "built", "predicted"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    model = load_model("wanders:Model")
    assert Path.cwd() == tmp_path
    for _ in range(2):
        predict_checked(model, (FRAME, FRAME), "a", "clean", 0)
    assert Path.cwd() == tmp_path


HEAVY = ("torch", "torchvision", "ptlflow", "onnx", "onnxruntime", "matplotlib", "polars", "numba", "skimage")
SCRIPT = f"""
import json, sys
from robustflow.cli.main import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["robustflow", "run", *arguments]
    try:
        main()
    except SystemExit as stop:
        print(f"exit {{stop.code}}", file=sys.stderr)
print([name for name in {HEAVY!r} if name in sys.modules])
"""

MISSING = (
    (("-m", "raft"), "raft"),
    (("-m", "raft", "--checkpoint", "no.ckpt"), "no.ckpt"),
    (("-m", "raft_large", "--checkpoint", "no.pth"), "no.pth"),
    (("-m", "arflow"), "arflow"),
    (("-m", "samflow_b", "--checkpoint", "no.pth"), "no.pth"),
    (("-m", "missing.onnx"), "missing.onnx"),
)


def test_missing_files_and_libraries_are_reported_before_loading(tmp_path):
    """One process for all commands, because each has to start without the heavy libraries."""
    arguments = json.dumps([arguments for arguments, _ in MISSING])
    ran = subprocess.run([sys.executable, "-c", SCRIPT, arguments], capture_output=True, text=True, cwd=tmp_path)
    lines = ran.stderr.splitlines()
    assert len(lines) == 2 * len(MISSING), ran.stderr
    for (_, culprit), line, code in zip(MISSING, lines[::2], lines[1::2], strict=True):
        assert line.startswith((f"robustflow: {culprit}: ", "robustflow: ptlflow: ", "robustflow: torch"))
        assert code == "exit 1"
    assert ran.stdout == "[]\n"


@pytest.mark.parametrize(
    ("name", "library", "extra"),
    [
        *((name, "ptlflow", "ptlflow") for name in ("raft", "dpflow", "memflow")),
        *((name, "torch", "torch") for name in ("arflow", "samflow_t")),
        ("raft_small", "torchvision", "torch"),
    ],
)
def test_without_the_extra_the_message_names_it(name, library, extra, monkeypatch):
    find = util.find_spec
    monkeypatch.setattr("robustflow.core.plugins.find_spec", lambda module: None if module == library else find(module))
    error = refusal(lambda: load_model(name, checkpoint="random"), AssetError, library)
    assert name in str(error)
    assert f"robustflow[{extra}]" in str(error)

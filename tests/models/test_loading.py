"""Models are loaded by name, by module and attribute, or from a folder."""

from pathlib import Path

import numpy as np
import pytest

from robustflow import load_model, write_flow
from robustflow.core.errors import DataError, ModelError, UsageError
from robustflow.models import FlowLookup, FlowModel, FunctionModel, ModelSpec
from robustflow.models.base import model_identity, predict_checked
from robustflow.models.loading import as_model
from robustflow.testing import ZeroFlow

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
    ("name", "options", "error", "says"),
    [
        ("{module}:Modell", {}, UsageError, "did you mean 'Model'"),
        ("{module}:Model", {"valu": 1}, UsageError, "did you mean 'value'"),
        ("{module}:built", {"value": 1}, UsageError, "does not accept options"),
        ("{module}:Broken", {}, ModelError, "weights are missing"),
        ("{module}:Script", {}, ModelError, "SystemExit: 2"),
        ("{module}:number", {}, ModelError, "neither a method predict"),
        ("no_such_module_here:Model", {}, UsageError, "cannot import 'no_such_module_here'"),
        ("tools/net.py:Model", {}, UsageError, "is a file; .* pass tools.net:Model"),
        ("nowhere/flows", {}, UsageError, "'nowhere/flows': no file, folder or model"),
        ("nowhere.ckpt", {}, UsageError, "'nowhere.ckpt': no file, folder or model"),
        (__file__, {}, UsageError, "is a file but not an exported network .*--checkpoint FILE"),
        ("", {}, UsageError, "the name of the model is empty"),
        ("diss", {}, UsageError, "did you mean 'dis'"),
        ("dis", {"presset": "fast"}, UsageError, "did you mean 'preset'"),
        ("dis", {"preset": "slow"}, UsageError, "unknown DIS preset 'slow'"),
    ],
)
def test_unloadable_models_are_refused(module, name, options, error, says):
    with pytest.raises(error, match=says):
        load_model(name.format(module=module), **options)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("~no_such_user_here/net.onnx", {}),
        ("~no_such_user_here/flows", {}),
        ("precomputed", {"folder": "~no_such_user_here"}),
        ("raft_small", {"checkpoint": "~no_such_user_here/raft.pth"}),
    ],
)
def test_a_path_of_an_unknown_user_is_refused(name, options):
    with pytest.raises(DataError, match="there is no such user; write out the full path"):
        load_model(name, **options)


@pytest.mark.parametrize(
    "spec", [ModelSpec("~nobody_here/a.onnx"), ModelSpec("raft", (("checkpoint", "~nobody_here/a"),))]
)
def test_an_early_check_refuses_a_path_of_an_unknown_user(spec):
    with pytest.raises(DataError, match="there is no such user; write out the full path"):
        spec.preflight()


def test_a_name_too_long_for_a_path_is_refused():
    with pytest.raises(DataError, match="not a valid path"):
        load_model("net:" + 300 * "x")


def test_objects_classes_and_functions_are_models():
    model = ZeroFlow()
    assert as_model(model, "it") is model
    assert isinstance(as_model(ZeroFlow, "it"), ZeroFlow)
    assert isinstance(as_model(lambda a, b: None, "it"), FunctionModel)
    with pytest.raises(ModelError, match="neither a method predict"):
        as_model(3, "it")


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
    with pytest.raises(ModelError, match="no flow for sample 'scene/a' under fog_3"):
        model.lookup("scene/a", "fog", 3)


def test_changed_flow_files_change_the_identity(tmp_path):
    (tmp_path / "clean").mkdir()
    empty = ModelSpec(str(tmp_path)).load().identity()
    write_flow(tmp_path / "clean" / "a.flo", np.zeros((4, 4, 2), np.float32))
    zeros = ModelSpec(str(tmp_path)).load().identity()
    write_flow(tmp_path / "clean" / "a.flo", np.ones((4, 4, 2), np.float32))
    ones = ModelSpec(str(tmp_path)).load().identity()
    assert len({found["files"] for found in (empty, zeros, ones)}) == 3


def test_a_folder_reached_through_links_is_the_same_model(tmp_path):
    (tmp_path / "there" / "clean").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "clean").symlink_to(tmp_path / "there" / "clean")
    write_flow(tmp_path / "there" / "clean" / "a.flo", np.zeros((4, 4, 2), np.float32))
    here, there = (ModelSpec(str(tmp_path / name)).load().identity() for name in ("here", "there"))
    assert here == there


def test_changed_flow_files_behind_a_link_change_the_identity(tmp_path):
    (tmp_path / "flows" / "clean").mkdir(parents=True)
    (tmp_path / "flows" / "clean" / "clip").symlink_to(tmp_path / "clip")
    (tmp_path / "clip").mkdir()
    identities = []
    for value in (0.0, 1.0):
        write_flow(tmp_path / "clip" / "1.flo", np.full((4, 4, 2), value, np.float32))
        model = load_model(str(tmp_path / "flows"))
        assert model.lookup("clip/1", "clean", 0).max() == value
        identities.append(model.identity())
    assert identities[0] != identities[1]


def test_flows_whose_names_are_not_utf_8_have_an_identity(tmp_path):
    (tmp_path / "clean").mkdir()
    before = load_model(str(tmp_path)).identity()
    (tmp_path / "clean" / "caf\udce9.flo").write_bytes(b"")
    assert load_model(str(tmp_path)).identity() != before


def test_wrong_folder_of_precomputed_flows_is_refused(tmp_path):
    (tmp_path / "clean").mkdir()
    with pytest.raises(ModelError, match="no folder 'clean'"):
        load_model("precomputed", folder=str(tmp_path / "clean"))
    with pytest.raises(UsageError, match="model 'precomputed'"):
        load_model("precomputed")
    with pytest.raises(UsageError, match=r"unknown option of model .* 'device'"):
        load_model(str(tmp_path), device="cpu")


def test_identity_of_a_model_is_converted_to_json(tmp_path):
    class Said:
        def identity(self):
            return {"checkpoint": tmp_path, "scale": (1, np.float32(0.5)), 3: "a"}

    assert model_identity(Said()) == {"checkpoint": str(tmp_path), "scale": [1, "0.5"], "3": "a"}
    Said.identity = lambda self: "version 2"
    with pytest.raises(ModelError, match=r"identity\(\) returned str; expected a dict"):
        model_identity(Said())


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


def test_script_that_exits_when_imported_is_refused(tmp_path, monkeypatch):
    (tmp_path / "script_for_test.py").write_text("import sys\nsys.exit(2)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UsageError, match=r"cannot import 'script_for_test'.*SystemExit: 2"):
        load_model("script_for_test:Model")

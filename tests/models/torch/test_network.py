"""Load the project's own networks by name; test their options and identities, and that the number of workers does not
affect the result rows.
"""

import hashlib
from importlib import util

import numpy as np
import pytest

from robustflow import load_model
from robustflow.errors import AssetError, ModelError, UsageError
from robustflow.models import ModelSpec

NAMES = ("arflow", "upflow", "brightflow")


@pytest.mark.parametrize("name", NAMES)
def test_without_the_extra_the_message_names_it(name, monkeypatch):
    find = util.find_spec
    monkeypatch.setattr("robustflow.extras.find_spec", lambda library: None if library == "torch" else find(library))
    with pytest.raises(AssetError, match=rf"model '{name}' needs PyTorch.*pip install 'robustflow\[torch\]'"):
        load_model(name)


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="needs the torch extra")


@pytest.fixture
def checkpoint(torch, tmp_path):
    """Write a network's seeded weights to a separate folder, in its authors' layout."""
    from robustflow.models.networks.arflow import ARFlow
    from robustflow.models.networks.brightflow import BrightFlow
    from robustflow.models.networks.upflow import UPFlow

    def write(name, folder="weights"):
        torch.manual_seed(0)
        state = {"arflow": ARFlow, "upflow": UPFlow, "brightflow": BrightFlow}[name]().state_dict()
        path = tmp_path / folder / f"{name}.pth"
        path.parent.mkdir(exist_ok=True)
        torch.save({"epoch": 3, "state_dict": {f"module.{key}": value for key, value in state.items()}}, path)
        return path

    return write


@pytest.mark.torch
@pytest.mark.parametrize("name", NAMES)
def test_without_a_checkpoint_the_message_names_the_file(name, torch, tmp_path):
    for options in ({}, {"checkpoint": tmp_path / "absent.pth"}):
        with pytest.raises(ModelError, match=rf"model '{name}'.*get .*https://github\.com/") as error:
            load_model(name, **options)
        assert "\n" not in str(error.value)


@pytest.mark.torch
@pytest.mark.parametrize("name", NAMES)
def test_a_checkpoint_makes_a_model_that_says_what_it_is(name, checkpoint):
    path = checkpoint(name)
    model = load_model(name, checkpoint=path, device="cpu")
    identity = model.identity()
    assert identity["name"] == name
    assert identity["checkpoint"] == hashlib.sha256(path.read_bytes()).hexdigest()
    frames = np.random.default_rng(0).integers(0, 256, (2, 70, 90, 3)).astype(np.uint8)
    flow = model.predict(*frames)
    assert flow.shape == (70, 90, 2)
    assert flow.dtype == np.float32
    assert np.isfinite(flow).all()


@pytest.mark.torch
def test_the_place_of_a_checkpoint_is_not_part_of_a_runs_identity(checkpoint):
    specs = [ModelSpec("upflow", (("checkpoint", str(checkpoint("upflow", folder))),)) for folder in ("a", "b")]
    one, other = (spec.identity(spec.load()) for spec in specs)
    assert one == other
    spec = ModelSpec("upflow", (*specs[0].options, ("mask_threshold", 1.0)))
    assert spec.identity(spec.load()) != one


@pytest.mark.torch
def test_half_precision_weights_are_recorded(checkpoint, torch):
    path = checkpoint("arflow")
    content = torch.load(path, weights_only=True)
    content["state_dict"] = {key: value.half() for key, value in content["state_dict"].items()}
    torch.save(content, path)
    assert load_model("arflow", checkpoint=path).identity()["weights_cast_from"] == "float16"


@pytest.mark.torch
@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("arflow", {"size": "100x200"}, "multiples of 64"),
        ("arflow", {"iterations": 12}, "unknown option of model 'arflow' 'iterations'"),
        ("upflow", {"iterations": 12}, "unknown option of model 'upflow' 'iterations'"),
        ("brightflow", {"iterations": 0}, "iterations must be an integer of at least 1"),
        ("brightflow", {"iterations": 1.5}, "iterations must be an integer of at least 1"),
        ("brightflow", {"iterations": True}, "iterations must be an integer of at least 1, not True"),
        ("upflow", {"align_corners": "no"}, "align_corners must be true or false, not 'no'"),
        ("upflow", {"mask_threshold": "high"}, "mask_threshold must be a number from 0 to 1, not 'high'"),
        ("upflow", {"mask_threshold": 1.5}, "mask_threshold must be a number from 0 to 1, not 1.5"),
        ("brightflow", {"precision": "fp64"}, "unknown precision 'fp64'"),
    ],
)
def test_options_that_cannot_be(name, options, says, checkpoint):
    with pytest.raises(UsageError, match=says):
        load_model(name, checkpoint=checkpoint(name), **options)


@pytest.mark.torch
def test_arflow_is_stretched_to_what_is_requested(checkpoint):
    path = checkpoint("arflow")
    sizes = {size: load_model("arflow", checkpoint=path, size=size).convention for size in ("64x128", "native")}
    assert sizes["64x128"].fitted_size(375, 1242) == (64, 128)
    assert sizes["native"].fitted_size(375, 1242) == (384, 1280)
    assert load_model("arflow", checkpoint=path).convention.fitted_size(375, 1242) == (256, 832)


@pytest.mark.torch
def test_iterations_change_the_flow(checkpoint):
    path = checkpoint("brightflow")
    frames = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3)).astype(np.uint8)
    flows = [load_model("brightflow", checkpoint=path, iterations=i).predict(*frames) for i in (1, 3)]
    assert np.abs(flows[0] - flows[1]).max() > 1e-4


@pytest.mark.torch
def test_the_same_rows_from_one_worker_and_two(checkpoint, tmp_path):
    from robustflow import evaluate

    spec = ModelSpec("arflow", (("checkpoint", str(checkpoint("arflow"))), ("size", "64x128"), ("device", "cpu")))
    tables = []
    for workers in (1, 2):
        result = evaluate(
            spec, output=tmp_path / f"run{workers}", corruptions=["contrast"], severities=[1, 5], workers=workers
        )
        tables.append(result.rows)
    assert tables[0].equals(tables[1])
    batched = evaluate(spec, output=tmp_path / "batched", corruptions=["contrast"], severities=[1, 5], batch_size=4)
    assert batched.manifest.identity_digest == result.manifest.identity_digest
    for total, count in (("epe_sum", "n_valid"), ("rcre_all_sum", "n_all")):
        means = [(rows[total] / rows[count]).to_numpy() for rows in (tables[0], batched.rows)]
        assert np.abs(means[0] - means[1]).max() <= 1e-4

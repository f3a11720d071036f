"""Load the networks by name; test their options, identities and files in the authors' layouts, and that neither workers
nor batches affect the result rows.
"""

import hashlib
from functools import cache

import numpy as np
import pytest

from robustflow import load_model
from robustflow.core.errors import ModelError
from robustflow.models import ModelRef
from robustflow.models.networks.loaders import NETWORKS
from robustflow.models.tiling import TiledModel

from ...refusals import refusal
from ..textures import noise_pair

FEW = {"brightflow": {"iterations": 2}, "samflow_t": {"iterations": 2, "tile": "none"}}
"""Options that make a network fast."""
SMALL = ("arflow", "upflow", "brightflow", "samflow_t", "flowdiffuser")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """Write a network's seeded weights in its authors' layout: SAMFlow's files are Lightning checkpoints, all others
    come from data-parallel training.
    """
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.models.networks.arflow import ARFlow
    from robustflow.models.networks.brightflow import BrightFlow
    from robustflow.models.networks.flowdiffuser import FlowDiffuser
    from robustflow.models.networks.samflow import SamFlow
    from robustflow.models.networks.upflow import UPFlow

    builders = dict(zip(SMALL, (ARFlow, UPFlow, BrightFlow, lambda: SamFlow("tiny"), FlowDiffuser), strict=True))

    @cache
    def write(name, folder="weights"):
        torch.manual_seed(0)
        prefix = "model" if name == "samflow_t" else "module"
        state = {f"{prefix}.{key}": value for key, value in builders[name]().state_dict().items()}
        path = tmp_path_factory.mktemp(folder) / f"{name}.pth"
        torch.save({"epoch": 3, "state_dict": state, "hyper_parameters": {}}, path)
        return path

    return write


@pytest.fixture
def load(checkpoint):
    return lambda name, **options: load_model(name, checkpoint=checkpoint(name), device="cpu", **options)


@pytest.mark.torch
@pytest.mark.parametrize("name", NETWORKS)
def test_without_a_checkpoint_the_message_names_the_file(name, tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    for options in ({}, {"checkpoint": tmp_path / "absent.pth"}):
        culprit = options.get("checkpoint", name)
        error = refusal(lambda options=options: load_model(name, **options), ModelError, culprit)
        assert "https://github.com/" in str(error)


@pytest.mark.torch
@pytest.mark.parametrize("name", SMALL)
def test_loaded_checkpoint_is_stated_in_the_identity(name, checkpoint, load):
    model = load(name, **FEW.get(name, {}))
    identity = model.identity()
    assert identity["name"] == name
    assert identity["checkpoint"] == hashlib.sha256(checkpoint(name).read_bytes()).hexdigest()
    flow = model.predict(*noise_pair(70, 90))
    assert flow.shape == (70, 90, 2)
    assert flow.dtype == np.float32
    assert np.isfinite(flow).all()


@pytest.mark.torch
@pytest.mark.parametrize(
    ("name", "option", "one", "other"),
    [
        ("arflow", "size", "64x128", "native"),
        ("brightflow", "iterations", 1, 3),
        ("samflow_t", "iterations", 2, 3),
        ("flowdiffuser", "seed", 0, 1),
        ("flowdiffuser", "vertical", "bottom", "both"),
    ],
)
def test_only_an_option_changes_the_flow_and_the_identity(name, option, one, other, load):
    frames = noise_pair(30, 45)
    models = [load(name, **{**FEW.get(name, {}), option: value}) for value in (one, one, other)]
    first, again, changed = (model.predict(*frames) for model in models)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - changed).max() > 1e-4
    assert models[0].identity() == models[1].identity() != models[2].identity()


@pytest.mark.torch
def test_tiles_of_the_authors_size_are_the_default_of_samflow(load):
    model = load("samflow_t")
    assert isinstance(model, TiledModel)
    assert model.identity()["tile"] == [432, 960]


@pytest.mark.torch
def test_the_place_of_a_checkpoint_is_not_part_of_a_runs_identity(checkpoint):
    refs = [ModelRef.parse("upflow", {"checkpoint": str(checkpoint("upflow", folder))}) for folder in ("a", "b")]
    one, other = (ref.identity(ref.load()) for ref in refs)
    assert one == other
    changed = refs[0].with_options({"mask_threshold": 1.0})
    assert changed.identity(changed.load()) != one


@pytest.mark.torch
def test_arflow_resizes_frames_to_the_requested_size(load):
    for options, fitted in (({}, (256, 832)), ({"size": "64x128"}, (64, 128)), ({"size": "native"}, (384, 1280))):
        assert load("arflow", **options).convention.fitted_size(375, 1242) == fitted

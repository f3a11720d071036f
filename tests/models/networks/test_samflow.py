"""Load SAMFlow by name, and test the layout of the authors' files, tiles, and error messages for invalid input."""

import inspect

import numpy as np
import pytest

from robustflow import load_model
from robustflow.errors import AssetError, ModelError, UsageError
from robustflow.models.registry import MODELS
from robustflow.models.tiling import TiledModel

from ..textures import noise_pair

NAMES = ("samflow_t", "samflow_b", "samflow_h")


@pytest.mark.parametrize("name", NAMES)
def test_every_size_is_offered_with_the_same_options(name):
    parameters = inspect.signature(MODELS.get(name)).parameters
    options = [option for option in parameters if option != "finetuned"]
    assert options == [
        *("checkpoint", "iterations", "tile", "sha256", "device", "precision", "compile", "threads"),
    ]
    assert ("finetuned" in parameters) == (name == "samflow_h")
    with pytest.raises(UsageError, match="did you mean 'iterations'"):
        load_model(name, iteration=3)
    with pytest.raises(UsageError, match="iterations must be an integer of at least 1"):
        load_model(name, iterations=0)


@pytest.mark.parametrize("name", NAMES)
def test_without_a_checkpoint_the_message_says_what_is_missing(name):
    with pytest.raises(
        (AssetError, ModelError), match=rf"model '{name}' needs (PyTorch|its checkpoint: get .*github\.com)"
    ):
        load_model(name)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """Write seeded weights in the layout of the authors' files, which are Lightning checkpoints."""
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.models.networks.samflow import SamFlow

    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("samflow") / "tiny.ckpt"
    state = {f"model.{key}": value for key, value in SamFlow("tiny").state_dict().items()}
    torch.save({"epoch": 1, "state_dict": state, "hyper_parameters": {}}, path)
    return path


@pytest.mark.torch
def test_tiles_of_the_authors_size_are_the_default(checkpoint):
    model = load_model("samflow_t", checkpoint=checkpoint, device="cpu", iterations=2)
    assert isinstance(model, TiledModel)
    identity = model.identity()
    assert identity["tile"] == [432, 960]
    assert identity["iterations"] == 2
    assert identity["name"] == "samflow_t"


@pytest.mark.torch
def test_iterations_matter_and_bf16_runs(checkpoint):
    frames = noise_pair(30, 45)
    options = {"checkpoint": checkpoint, "device": "cpu", "tile": "none"}
    two, three = (load_model("samflow_t", iterations=n, **options).predict(*frames) for n in (2, 3))
    assert two.shape == (30, 45, 2)
    assert np.abs(two - three).max() > 1e-3
    low = load_model("samflow_t", iterations=2, precision="bf16", **options).predict(*frames)
    assert 0 < np.abs(low - two).max() < 0.1 * np.abs(two).max() + 0.1


@pytest.mark.torch
def test_a_checkpoint_of_another_size_is_refused(checkpoint):
    from robustflow.models.networks.samflow import SamFlow
    from robustflow.models.torch.checkpoint import read_checkpoint
    from robustflow.models.torch.weights import load_weights

    other = SamFlow("tiny")
    other.wadd_1 = None  # this entry distinguishes the two published files of the largest size
    with pytest.raises(ModelError, match=r"1 unexpected \(wadd_1\.add_weight\)"):
        load_weights(other, read_checkpoint(checkpoint), "samflow_h")

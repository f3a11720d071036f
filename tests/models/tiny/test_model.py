"""Load the small network by name, and test it with and without PyTorch."""

import json
import re

import numpy as np
import pytest

from robustflow import load_model
from robustflow.core.errors import UsageError
from robustflow.data.datasets import load_dataset
from robustflow.models.tiny.model import SHIPPED, shipped_weights
from robustflow.testing import check_model

from ...guide_blocks import DOCS
from ...refusals import refusal
from ...shared_data import shared_folder

PAGE = DOCS / "tiny.md"


def error(flow, sample):
    return float(np.linalg.norm(flow - sample.flow, axis=2)[sample.valid].mean())


@pytest.mark.parametrize(
    ("name", "shapes", "most"),
    [
        *((name, {"pairs": 6, "size": "96x160", "seed": 11}, 0.35) for name in SHIPPED),
        pytest.param("tiny", {"pairs": 200, "size": "160x224"}, 0.2, marks=pytest.mark.slow),
    ],
)
def test_on_unseen_shapes_the_error_is_a_fraction_of_zero_flows(name, shapes, most):
    model = load_model(name, runtime="numpy")
    samples = load_dataset("shapes", **shapes)
    found = [error(model.predict(*sample.frames), sample) for sample in samples]
    still = [error(np.zeros_like(sample.flow), sample) for sample in samples]
    assert np.mean(found) <= most * np.mean(still)


@pytest.mark.parametrize(
    ("data", "options"),
    [
        ("middlebury", {}),
        ("kitti2015", {}),
        ("kitti2012", {}),
        ("sintel", {"render_pass": "unlabelled_pass"}),
        ("flyingchairs", {}),
    ],
)
def test_on_every_shared_pair_it_is_better_than_zero_flow(data, options):
    model = load_model("tiny", runtime="numpy")
    for sample in load_dataset(data, shared_folder("data", data), **options):
        assert error(model.predict(*sample.frames), sample) < error(np.zeros_like(sample.flow), sample), sample.key


def test_the_weights_differ_and_say_how_they_were_made():
    shipped = [shipped_weights(name) for name in SHIPPED]
    assert len({one.sha256 for one in shipped}) == len(SHIPPED)
    for one in shipped:
        assert one.about["made_by"].startswith("robustflow train tiny --recipe shapes")
        assert re.fullmatch("[0-9a-f]{40}", one.about["commit"])
        training = json.loads(one.about["training"])
        assert {"recipe", "seed", "data", "start", "corruptions"} <= training.keys()
        assert training["start_trained_on"] == ["shapes"]
        assert one.trained_on == "shapes"


def test_tiny_passes_check_model_and_is_identified_by_weights_and_runtime():
    model = load_model("tiny", runtime="numpy")
    check_model(model)
    assert model.identity() == {"name": "tiny", "checkpoint": shipped_weights("tiny").sha256, "runtime": "numpy"}


@pytest.mark.parametrize(
    "options",
    [{"runtime": "onnx"}, {"runtime": "numpy", "device": "cuda"}, {"runtime": "numpy", "precision": "bf16"},
     {"runtime": "numpy", "checkpoint": "random"}],
)  # fmt: skip
def test_invalid_runtime_or_options_without_effect_are_refused(options):
    refusal(lambda: load_model("tiny", **options), UsageError, "onnx" if "onnx" in options.values() else "runtime")


@pytest.mark.torch
@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("size", [(96, 160), (101, 75), (33, 250)])
def test_numpy_and_pytorch_agree(name, size):
    """PyTorch's single precision differs from double precision by up to 1.6e-4 px on KITTI pairs."""
    pytest.importorskip("torch", reason="needs the torch extra")
    sample = load_dataset("shapes", pairs=1, size=f"{size[0]}x{size[1]}", seed=5)[0]
    flows = [load_model(name, runtime=runtime, **device).predict(*sample.frames)
             for runtime, device in (("numpy", {}), ("torch", {"device": "cpu"}))]  # fmt: skip
    difference = np.abs(flows[0] - flows[1])
    assert difference.mean() < 1e-5
    assert np.percentile(difference, 99.9) < 1e-4
    assert difference.max() < 5e-4


@pytest.mark.torch
def test_numpy_and_pytorch_agree_on_long_motion_as_closely_as_the_docs_say():
    pytest.importorskip("torch", reason="needs the torch extra")
    stated = re.search(
        r"agree\s+within (\S+) px at 99\.9 % of\s+the\s+pixels and (\S+) px at the worst", PAGE.read_text()
    )
    assert stated is not None
    sample = load_dataset("kitti2012", shared_folder("data", "kitti2012"))["000151"]  # the largest of 15 values
    flows = [load_model("tiny", runtime=runtime).predict(*sample.frames) for runtime in ("numpy", "torch")]
    difference = np.abs(flows[0] - flows[1])
    assert np.percentile(difference, 99.9) < float(stated[1])
    assert difference.max() < float(stated[2])

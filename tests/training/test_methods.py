"""Every method with a recipe makes real steps on real pairs and trains exactly the parameters that its recipe
specifies."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.training.recipe import Recipe, load_recipe, recipes_of, trained_methods  # noqa: E402
from robustflow.training.request import DataPlan, Request  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402
from robustflow.training.trained_network import load_network  # noqa: E402

from .progress import lines, train_in_two_processes  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.slow]

STEPS = 3
SUPERVISED = [name for name in trained_methods() if "unsupervised" not in recipes_of(name)]
_NO_BATCHNORM = ("flowformer", "flowformer_pp", "flowdiffuser", "tiny")


def three_steps(method: str, precision: str, folder: Path, data: Path) -> Request:
    """A request for three updates on small crops of KITTI pairs."""
    stage = "ood" if "ood" in recipes_of(method) else next(iter(recipes_of(method)))
    recipe = load_recipe(method, stage)
    if not recipe.method.startswith(("raft_", "samflow", "flowdiffuser", "tiny")):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    mix = folder / "mix.toml"
    mix.write_text(
        'parts = [{data = "kitti2015", times = 4, augmentation = "sparse", log2_scale = [-0.2, 0.4], flip = false}]'
    )
    small = recipe.changed(
        steps=STEPS * recipe.accumulate,
        batch=2,
        crop=(128, 192),
        iterations=2,
        precision=precision,
        mix=str(mix),
        devices=1,
    )
    request = Request(small, DataPlan([data], loaders=0), folder / "out", start="random", device="cpu")
    if method == "csflow":
        return replace(request, start=str(_csflow_within_the_frame(small, folder)))
    return request


def _csflow_within_the_frame(recipe: Recipe, folder: Path) -> Path:
    """CSFlow computes its initial flow as a sum of correlations. With random weights, that flow is thousands of pixels
    long, so the network only reads zeros outside the frame; features scaled by 1/30 keep the flow inside the frame.
    """
    _, network = load_network(recipe, "random")
    weights = network.weights()
    for name in ("fnet.conv2.weight", "fnet.conv2.bias"):
        weights[name] = weights[name] / 30
    torch.save(weights, folder / "first.pth")
    return folder / "first.pth"


def assert_learned(request: Request) -> None:
    """Losses are finite; every trained parameter has a gradient, except those that the recipe lists as unused; frozen
    parameters do not change; BatchNorm's statistics change only if the recipe allows it.
    """
    recipe, folder = request.recipe, request.output
    entries = lines(folder)
    assert len(entries) == STEPS
    assert all(math.isfinite(entry["loss"]) and entry["gradient_norm"] > 0 for entry in entries)

    _, network = load_network(recipe, str(request.start))
    before, content = network.weights(), torch.load(folder / "last.pth", weights_only=True)
    after, moments = content["model"], content["optimizer"]["state"]
    learning = [
        name.removeprefix("net.").removeprefix("model.")
        for name, value in network.named_parameters()
        if value.requires_grad
    ]
    # Adam's first moment averages the gradients so far, so it contains the gradient of every step.
    without = {
        name for number, name in enumerate(learning) if number not in moments or not moments[number]["exp_avg"].any()
    }
    assert without == {name for name in learning if recipe.unused and name.startswith(recipe.unused)}
    same = {name for name in before if torch.equal(before[name], after[name])}
    # A parameter that has not changed had a gradient below AdamW's epsilon, which is rounding error: the gradient of a
    # key's bias, which adds the same value to every score that softmax compares.
    still = [number for number, name in enumerate(learning) if name in same and name not in without]
    assert all(moments[number]["exp_avg"].abs().max() < 1e-8 for number in still)
    frozen = {name for name in before if recipe.frozen and name.startswith(recipe.frozen)}
    assert frozen <= same
    assert bool(frozen) == bool(recipe.frozen)
    running = {name for name in before if name.endswith("running_mean") and name not in frozen}
    if recipe.method in _NO_BATCHNORM or recipe.method.startswith("samflow"):
        assert not running
    elif recipe.frozen_norms == "none":
        assert running & same == set(), "BatchNorm is trained, but a running mean did not change"
    else:
        assert running <= same


# samflow_h needs 6.5 GB; on a CPU, a bfloat16 convolution of any larger network than RAFT-small takes a minute.
@pytest.mark.parametrize(
    ("method", "precision"), [*((method, "fp32") for method in SUPERVISED), ("raft_small", "bf16")]
)
def test_every_method_trains_for_three_steps(method, precision, shared, tmp_path):
    request = three_steps(method, precision, tmp_path, shared("data"))
    run_training(request)
    assert_learned(request)


@pytest.mark.parametrize("method", [name for name in SUPERVISED if name not in ("samflow_b", "samflow_h")])  # memory
def test_every_method_trains_for_three_steps_in_two_processes(method, shared, tmp_path):
    request = three_steps(method, "fp32", tmp_path, shared("data"))
    train_in_two_processes(request, tmp_path, timeout=1800)
    assert_learned(request)

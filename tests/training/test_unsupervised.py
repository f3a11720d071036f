"""Training without labels: real steps of each method on real pairs, exact resumption, and overfitting to one pair."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.core.errors import UsageError  # noqa: E402
from robustflow.models import load_model  # noqa: E402
from robustflow.training.plan_text import plan_text  # noqa: E402
from robustflow.training.recipe import Recipe, load_recipe  # noqa: E402
from robustflow.training.request import DataPlan, Request  # noqa: E402
from robustflow.training.session import run_training  # noqa: E402
from robustflow.training.trained_network import load_network  # noqa: E402

from ..refusals import refusal  # noqa: E402
from .progress import assert_same_training, lines, weights  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch]

STEPS = 3
MIXES = {
    "arflow": 'augmentation = "stretched"',
    "upflow": 'augmentation = "cropped", margin = 8',
    "brightflow": 'augmentation = "dense", log2_scale = [-0.2, 0.6]',
}


def mix(folder: Path, augmentation: str, data: str = "kitti2015") -> str:
    path = folder / "mix.toml"
    path.write_text(f'parts = [{{data = "{data}", {augmentation}, flip = true}}]\n', encoding="utf-8")
    return str(path)


def small(method: str, folder: Path, **changes) -> Recipe:
    """The method's recipe with a small crop."""
    recipe = load_recipe(method, "unsupervised")
    assert recipe.objective is not None
    objective = recipe.objective.model_dump()
    if method == "brightflow":
        objective["border"] = 16
    elif method == "arflow":
        objective["census_from"] = 0.5  # with untrained weights, the occlusion check finds no visible pixels
    values = {"steps": STEPS, "batch": 2, "crop": (64, 128), "objective": objective}
    if "mix" not in changes:
        values["mix"] = mix(folder, MIXES[method])
    return recipe.changed(**{**values, **changes}, iterations=2 if recipe.iterations else None)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "precision"), [*((method, "fp32") for method in MIXES), ("arflow", "bf16")])
def test_every_unsupervised_method_trains_for_three_steps(method, precision, shared, tmp_path):
    recipe = small(method, tmp_path, precision=precision)
    data = DataPlan([shared("data")], loaders=0)
    request = Request(recipe, data, tmp_path / "out", start="random", device="cpu")
    last = run_training(request)
    entries = lines(request.output)
    assert len(entries) == STEPS
    assert all(math.isfinite(entry["loss"]) and entry["gradient_norm"] > 0 for entry in entries)
    assert all(entry["photometric"] > 0 for entry in (entries if method != "arflow" else entries[:2]))
    if method != "upflow":
        assert entries[0 if method == "arflow" else -1]["self_supervision"] > 0
    _, network = load_network(recipe, "random")
    before, after = network.weights(), weights(last)
    assert before.keys() == after.keys()
    assert [name for name in before if torch.equal(before[name], after[name])] == []
    frame = torch.zeros(64, 128, 3, dtype=torch.uint8).numpy()
    assert load_model(method, checkpoint=str(last), device="cpu").predict(frame, frame).shape == (64, 128, 2)


def test_resumed_training_equals_an_uninterrupted_one(request_for, tmp_path):
    recipe = small("arflow", tmp_path, steps=2, mix=mix(tmp_path, MIXES["arflow"], "flyingchairs"))
    whole = replace(request_for("whole"), recipe=recipe)
    run_training(whole)
    parted = replace(request_for("parted"), recipe=recipe)
    run_training(parted, lambda: True)
    assert len(lines(parted.output)) == 1
    run_training(replace(parted, resume=True))
    assert_same_training(whole.output, parted.output)


@pytest.mark.parametrize(("method", "crop"), [("arflow", (96, 128)), ("brightflow", (128, 192))])
def test_invalid_crop_is_refused(method, crop, request_for, tmp_path):
    recipe = load_recipe(method, "unsupervised").changed(
        crop=crop, batch=2, mix=mix(tmp_path, MIXES["arflow"], "flyingchairs")
    )
    refusal(lambda: run_training(replace(request_for("crop"), recipe=recipe)), UsageError, "--crop")


def test_the_plan_finds_the_data_of_a_recipe_without_labels(tmp_path):
    folder = tmp_path / "data_scene_flow_multiview" / "training"
    for frame, camera in itertools.product(range(21), ("image_2", "image_3")):
        (folder / camera).mkdir(parents=True, exist_ok=True)
        (folder / camera / f"000000_{frame:02d}.png").touch()
    text = plan_text(load_recipe("arflow", "unsupervised"), DataPlan([tmp_path]))
    assert "objective smooth: 75.0\n" in text
    assert "30 pairs x 1, 100.0 % of an epoch; augmentation stretched; " in text
    labelled = load_recipe("raft", "chairs").changed(mix="kitti_multiview")
    assert "missing  " in plan_text(labelled, DataPlan([tmp_path]))

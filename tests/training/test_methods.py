"""Every method with a recipe makes real steps on real pairs, and what learns is what its recipe says."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.training.networks import load_network  # noqa: E402
from robustflow.training.recipe import load_recipe, recipes_of, trained_methods  # noqa: E402
from robustflow.training.session import Request, run_training  # noqa: E402

pytestmark = [pytest.mark.training, pytest.mark.torch, pytest.mark.slow]

UNUSED = ("att.pos_emb.", "attn_softaggr.feat2score.")
"""Parameters that a network has and does not use, in the original too: GMA's and SKFlow's position embedding, CRAFT's
score of a single mode."""
STEPS = 3
METHODS = [name for name in trained_methods() if {"ood", "chairs"} & recipes_of(name).keys() and name != "samflow_h"]
"""Those of the paper's supervised methods; samflow_h has 2.6 GB of weights."""


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("method", METHODS)
def test_three_steps(method, precision, shared, tmp_path):
    if not method.startswith(("raft_", "samflow")):
        pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    stage = "ood" if "ood" in recipes_of(method) else "chairs"
    recipe = load_recipe(method, stage).changed(
        steps=STEPS * load_recipe(method, stage).accumulate,
        batch=2,
        crop=(128, 192),
        iterations=2,
        precision=precision,
        mix="kitti",
        devices=1,
    )
    request = Request(recipe, [shared("data")], tmp_path, start="random", device="cpu", loaders=0)
    run_training(request)
    entries = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert len(entries) == STEPS + recipe.one_more
    assert all(math.isfinite(entry["loss"]) and entry["gradient_norm"] > 0 for entry in entries)

    _, network = load_network(recipe, "random")
    before, after = network.weights(), torch.load(tmp_path / "last.pth", weights_only=True)["model"]
    learning = {
        name.removeprefix("net.").removeprefix("model.")
        for name, value in network.named_parameters()
        if value.requires_grad
    }
    assert learning <= before.keys()
    same = {name for name in before if torch.equal(before[name], after[name])}
    assert [name for name in sorted(learning & same) if not any(part in name for part in UNUSED)] == []
    assert [name for name in before if name.startswith(recipe.frozen) and name not in same] == []
    running = {name for name in before if name.endswith("running_mean")}
    if recipe.frozen_norms == "none" and method not in ("flowformer", "flowformer_pp"):
        assert running - same, "BatchNorm learns, and no running mean moved"
    elif recipe.frozen_norms != "none":
        assert running <= same


def test_raft_small_learns_one_pair_by_heart(shared, tmp_path):
    mix = tmp_path / "one.toml"
    mix.write_text(
        'parts = [{data = "middlebury", augmentation = "dense", log2_scale = [0.0, 0.0], flip = false}]\n', "utf-8"
    )
    folder = tmp_path / "data"
    for path in shared("data/middlebury").rglob("*"):
        if path.is_file() and path.parent.name == "RubberWhale":
            place = folder / path.relative_to(shared("data/middlebury"))
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(path)
    recipe = load_recipe("raft_small", "chairs").changed(
        steps=600, batch=1, crop=(128, 192), iterations=6, mix=str(mix), learning_rate=4e-4, devices=1
    )
    request = Request(recipe, [f"middlebury={folder}"], tmp_path / "out", start="random", device="cpu", loaders=1)
    run_training(replace(request, save_every=1000))
    lines = (tmp_path / "out" / "metrics.jsonl").read_text().splitlines()
    errors = [json.loads(line)["epe"] for line in lines]
    assert sum(errors[-20:]) / 20 < 0.5
    assert sum(errors[:5]) / 5 > 1.0

"""Recipes have the values of the papers, the order of the pairs uses each once, and a plan counts the memory."""

import csv
import tomllib
from importlib.resources import files

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import UsageError
from robustflow.models.registered import MODELS
from robustflow.training.data.parts import Order
from robustflow.training.plan_text import expected_memory, plan_text
from robustflow.training.recipe import load_recipe, mix_parts, recipes_of, trained_methods
from robustflow.training.request import DataPlan

from ..refusals import refusal

pytestmark = pytest.mark.training

_METHODS = {
    "RAFT": "raft",
    "GMA": "gma",
    "CSFlow": "csflow",
    "SKFlow": "skflow",
    "GMFlowNet": "gmflownet",
    "CRAFT": "craft",
    "FlowFormer": "flowformer",
    "FlowFormer++": "flowformer_pp",
    "SAMFlow": "samflow_b",
    "FlowDiffuser": "flowdiffuser",
}


@pytest.mark.parametrize("stage", ["ood", "id"])
def test_recipes_equal_the_tables_of_the_papers(shared, stage):
    with open(shared(f"paper/recipes_{stage}.csv"), encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["model"] for row in rows} == set(_METHODS)
    for row in rows:
        recipe = load_recipe(_METHODS[row["model"]], stage)
        assert recipe.steps == int(row["steps"])
        assert recipe.batch == int(row["batch_size"])
        assert f"{recipe.crop[0]}x{recipe.crop[1]}" == row["crop"]
        assert recipe.iterations == int(row["iters"])
        assert (recipe.precision != "fp32") == (row["mixed_precision"] == "yes")
        for value, column in (
            (recipe.learning_rate, "lr"),
            (recipe.optimizer.weight_decay, "weight_decay"),
            (recipe.gamma, "gamma"),
        ):
            assert value == pytest.approx(float(row[column]), rel=1e-12)


def test_stages_of_flowdiffuser_are_those_of_its_script(shared):
    lines = (shared("parity/training_flowdiffuser") / "README.md").read_text().splitlines()
    header = lines.index("| stage | steps | batch | crop | lr | decay | gamma |")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[header + 2 : header + 6]]
    assert [row[0].split()[0] for row in rows] == ["chairs", "things", "sintel", "kitti"]
    for stage, steps, batch, crop, rate, decay, gamma in rows:
        recipe = load_recipe("flowdiffuser", stage.split()[0])
        assert (recipe.updates, recipe.batch) == (1000 * int(steps.removesuffix("k")) + 1, int(batch))
        assert f"{recipe.crop[0]}x{recipe.crop[1]}" == crop
        assert (recipe.learning_rate, recipe.optimizer.weight_decay, recipe.gamma) == tuple(
            map(float, (rate, decay, gamma))
        )
        assert (recipe.precision, recipe.noise, recipe.frozen_norms) == ("fp32", 0, "none")


@pytest.mark.parametrize("method", trained_methods())
def test_every_recipe_is_of_a_model_that_runs_and_of_data_that_are_known(method):
    from robustflow.data.datasets import DATASETS

    assert method in MODELS or method == "gmflownet_mix"
    for stage, recipe in recipes_of(method).items():
        assert (recipe.method.removeprefix("ptlflow:"), recipe.stage) == (method, stage)
        assert (
            recipe.start == "random"
            or recipe.start in recipes_of(method)
            or recipe.start in ("chairs", "things", "sintel")
        )
        used = [part.data for part in mix_parts(recipe.mix)]
        assert used
        assert all(name in DATASETS for name in used)
        assert recipe.source


def test_mix_of_the_paper_has_the_stated_shares():
    counts = {"sintel": 1041, "hd1k": 1047, "flyingthings3d": 20151}
    places = [counts[part.data] * part.times for part in mix_parts("ood")]
    assert sum(places) == 253_737
    by_set = {
        name: sum(n for part, n in zip(mix_parts("ood"), places, strict=True) if part.data == name) for name in counts
    }
    shares = {name: round(100 * count / sum(places), 1) for name, count in by_set.items()}
    assert shares == {"sintel": 82.1, "hd1k": 2.1, "flyingthings3d": 15.9}


@pytest.mark.parametrize("method", trained_methods())
def test_steps_option_sets_the_number_of_updates(method):
    for stage in recipes_of(method).values():
        assert stage.changed(steps=2 * stage.accumulate).updates == 2
        assert stage.changed(crop=(64, 96)).updates == stage.updates


ARFLOW = {"raw": ("random", 0.05), "unsupervised": ("raw", 0.0)}
ORIGINALS = [
    ("raft", "ood", {"updates": 100_001}),
    ("gma", "ood", {"updates": 120_000}),
    *(("craft", stage, {"devices": 2, "frozen_norms": "none"}) for stage in recipes_of("craft")),
    *((name, stage, {"schedule_ahead": 1}) for name in ("gmflownet", "gmflownet_mix") for stage in recipes_of(name)),
    *(("arflow", stage, {"updates": 1000 * 1001, "start": start}) for stage, (start, _) in ARFLOW.items()),
    *(  # noise, precision and schedule as in the paper
        (f"samflow_{size}", stage, {"pairs": 6, "updates": updates, "noise": 0.0, "precision": "fp32", "batch": 3})
        for size in "tbh"
        for stage, updates in (("ood", 120_000), ("id", 25_000))
    ),
]


@pytest.mark.parametrize(("method", "stage", "settings"), ORIGINALS)
def test_recipes_have_the_settings_of_the_originals(method, stage, settings):
    recipe = load_recipe(method, stage)
    assert {name: getattr(recipe, name) for name in settings} == settings
    if method.startswith("samflow"):
        assert recipe == load_recipe("samflow_t", stage).changed(method=method)


def test_mixes_and_objectives_are_those_of_the_originals():
    for method in ("gmflownet", "gmflownet_mix"):
        assert {part.data for part in mix_parts(load_recipe(method, "sintel").mix)} == {"sintel", "flyingthings3d"}
    for stage in ("unsupervised", "sintel"):
        parts = mix_parts(load_recipe("brightflow", stage).mix)
        assert {(part.flip, bool(part.eraser)) for part in parts} == {(True, False)}
    for stage, (_, share) in ARFLOW.items():
        objective = load_recipe("arflow", stage).objective
        assert objective.census_from == pytest.approx(share, rel=0.01)
        assert (objective.self_supervision > 0) == (stage == "unsupervised")


@pytest.mark.parametrize("method", trained_methods())
def test_remarks_of_a_stage_add_to_those_of_all_stages(method):
    document = tomllib.loads(files("robustflow.training").joinpath("recipes", f"{method}.toml").read_text("utf-8"))
    if "same_as" in document:
        assert recipes_of(document["same_as"]).keys() == recipes_of(method).keys()
        return
    common = document.pop("all", {})
    for stage, own in document.items():
        recipe = load_recipe(method, stage)
        text = plan_text(recipe, DataPlan())
        for name in ("unverified", "differs"):
            given = [part.get(name, []) for part in (common, own)]
            remarks = [remark for one in given for remark in ([one] if isinstance(one, str) else one)]
            assert list(getattr(recipe, name)) == remarks
            assert all(text.count(f"  {remark}\n") == 1 for remark in remarks)


def test_the_digest_names_what_decides_the_weights():
    recipe = load_recipe("raft", "id")
    assert recipe.changed(batch=2).digest() != recipe.digest()
    assert recipe.changed(learning_rate=None).digest() == recipe.digest()


@pytest.mark.parametrize(("method", "stage", "culprit"), [("raft", "odd", "odd"), ("rafd", "ood", "rafd")])
def test_unknown_recipe_is_refused(method, stage, culprit):
    refusal(lambda: load_recipe(method, stage), UsageError, culprit)


@pytest.mark.parametrize(
    "change",
    [
        {"steps": 0},
        {"batch": -1},
        {"learning_rate": 0.0},
        {"learning_rate": float("inf")},
        {"precision": "fp8"},
    ],
)
def test_invalid_value_of_a_recipe_is_refused(change):
    (name,) = change
    refusal(lambda: load_recipe("raft", "ood").changed(**change), UsageError, name)


@pytest.mark.parametrize(
    ("valid", "invalid"),
    [
        ("log2_scale = [-3, 3]", "log2_scale = [-3.01, 3]"),
        ("log2_scale = [1, 1]", "log2_scale = [0, inf]"),
        ("log2_scale = [0, 3]", "log2_scale = [0, 3.01]"),
        ("log2_scale = [0.1, 0.2]", "log2_scale = [0.2, 0.1]"),
        ("times = 1000", "times = 1001"),
        ("times = 1", "times = 0"),
        ("margin = 1000", "margin = 1001"),
        ("margin = 0", "margin = -1"),
        ("eraser = false", "erasor = false"),
    ],
)
def test_value_of_a_mix_outside_its_range_is_refused_and_at_its_limit_used(tmp_path, valid, invalid):
    mix, text = tmp_path / "mix.toml", 'parts = [{data = "hd1k", augmentation = "dense", flip = true, VALUE}]'
    mix.write_text(text.replace("VALUE", valid))
    assert len(mix_parts(str(mix))) == 1
    for refused in (text.replace("VALUE", invalid), "seed = 1\n" + text.replace("VALUE", valid)):
        mix.write_text(refused)
        refusal(lambda: mix_parts(str(mix)), UsageError, mix)


def test_steps_that_are_less_than_one_update_are_refused():
    refusal(lambda: load_recipe("raft", "ood").changed(steps=3, accumulate=4), UsageError, "--steps")


@given(count=st.integers(1, 300), block=st.integers(1, 12), seed=st.integers(0, 99), epoch=st.integers(0, 3))
def test_epoch_uses_every_pair_at_most_once_and_omits_less_than_one_update(count, block, seed, epoch):
    if count < block:
        refusal(lambda: Order(count, block, seed), UsageError, "--batch-size")
        return
    order = Order(count, block, seed)
    each = count - count % block
    places = [order.place(epoch * each + offset) for offset in range(each)]
    assert len(set(places)) == each
    assert set(places) <= set(range(count))


def test_order_differs_between_epochs_and_seeds():
    order, other = Order(200, 4, 0), Order(200, 4, 1)
    first = [order.place(n) for n in range(200)]
    assert first != [order.place(200 + n) for n in range(200)]
    assert first != [other.place(n) for n in range(200)]


def test_a_pair_that_cannot_be_read_is_replaced_by_another_each_time():
    order = Order(1000, 4, 0)
    assert len({order.place(7, attempt) for attempt in range(20)}) > 15
    assert order.place(7, 3) == Order(1000, 4, 0).place(7, 3)


def test_memory_of_a_different_crop_is_estimated():
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    pytest.importorskip("torchvision", reason="needs the torch extra")
    from robustflow.training.losses.supervised import sequence_loss
    from robustflow.training.trained_network import load_network

    recipe = load_recipe("raft_small", "things").changed(crop=(160, 224), batch=2, iterations=2, devices=1)
    _, network = load_network(recipe, "random")
    network.train()
    known = {value.untyped_storage().data_ptr() for value in [*network.parameters(), *network.buffers()]}
    kept = {}

    def keep(tensor):
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in known:
            kept[storage.data_ptr()] = storage
        return tensor

    images = torch.rand(2, 2, 3, 160, 224) * 255
    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        sequence_loss(network(*images), torch.zeros(2, 2, 160, 224), torch.ones(2, 160, 224))
    weights = 16 * sum(value.numel() for value in network.parameters())
    counted = (sum(storage.nbytes() for storage in kept.values()) + weights) / 2**30
    assert expected_memory(recipe) == pytest.approx(counted, rel=0.03)
    assert f"{counted:.1f} GiB" in plan_text(recipe, DataPlan())
    assert expected_memory(recipe.changed(method="somewhere:Net")) is None
    assert all(expected_memory(load_recipe(name, "ood")) for name in ("raft", "gma", "skflow", "gmflownet"))

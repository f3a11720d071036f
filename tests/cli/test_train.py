"""Test the command `robustflow train`: the plan, and bad input that is refused before any heavy import."""

from __future__ import annotations

import shlex

import pytest
from typer.main import get_command

from robustflow.cli.main import app
from robustflow.core.errors import UsageError
from robustflow.data.datasets import dataset_facts
from robustflow.training.plan_text import plan_text
from robustflow.training.recipe import load_recipe
from robustflow.training.request import DataPlan
from tests.data.datasets import layouts
from tests.refusals import refusal

pytestmark = pytest.mark.training


def test_plan_names_missing_data_and_the_folders_searched(tmp_path):
    text = plan_text(load_recipe("raft", "ood"), DataPlan([tmp_path]))
    assert text.count("missing  ") == 5
    assert "mpisintel" in text
    assert "\nupdates: 100001\n" in text


def test_plan_counts_the_pairs_of_the_data(shared):
    recipe = load_recipe("raft", "kitti").changed(steps=7, batch=2)
    text = plan_text(recipe, DataPlan([shared("data")]))
    pairs = len(list(shared("data/kitti2015/training/flow_occ").glob("*.png")))
    title = dataset_facts("kitti2015").title
    assert f"found    {title}: {pairs} pairs x 1, 100.0 % of an epoch; augmentation sparse" in text
    assert f"{pairs} pairs per epoch; 7 updates are {7 / (pairs // 2):.2f} epochs" in text  # the rest is left out
    large = plan_text(recipe.changed(batch=pairs + 1), DataPlan([shared("data")]))
    assert " batch_size: " in large


def test_the_plan_names_every_value_that_the_user_changed(tmp_path):
    original = load_recipe("raft", "kitti")
    text = plan_text(original.changed(steps=6, crop=(64, 96)), DataPlan([tmp_path]), original)
    changes = {line.partition(":")[0]: line for line in text.splitlines() if " instead of " in line}
    assert changes == {
        "steps": "steps: 6 instead of 50000",
        "extra_update": "extra_update: False instead of True",
        "crop": "crop: 64, 96 instead of 288, 960",
    }
    assert " instead of " not in plan_text(original, DataPlan([tmp_path]), original)


def test_recipes_are_listed(robustflow):
    lines = [" ".join(line.split()) for line in robustflow.prints("list", "recipes").splitlines()]
    for updates in ("100001 updates of 6 pairs at 368x768", "120000 updates of 6 pairs at 432x960"):  # in two steps
        assert f"ood {updates} learning rate 0.000125, starts from things, trained on ood" in lines


def test_plan_names_the_corruptions_of_the_frames_and_refuses_unknown_ones():
    recipe = load_recipe("raft", "ood")
    text = plan_text(recipe, DataPlan(corruptions=["fog", "snow"], probability=0.25))
    assert "corrupted pairs: 25 %: fog, snow\n" in text
    refusal(lambda: plan_text(recipe, DataPlan(corruptions=["fogg"])), UsageError, "fogg")


def test_a_pass_of_sintel_that_is_missing_is_named_without_an_option_that_train_lacks(tmp_path):
    for name in ("albedo", "flow"):
        (tmp_path / "sintel/training" / name / "alley_1").mkdir(parents=True)
    text = plan_text(load_recipe("raft", "ood"), DataPlan([tmp_path]))
    assert "albedo" in text
    accepted = {name for parameter in get_command(app).commands["train"].params for name in parameter.opts}
    assert {word for word in text.split() if word.startswith("-")} <= accepted


def test_a_folder_of_kitti_without_occluded_pixels_is_named_before_training(tmp_path):
    layouts.kitti(tmp_path / "kitti2015", ["000001"], occ=False)
    with pytest.warns(UserWarning, match="kitti2015"):
        plan_text(load_recipe("raft", "kitti"), DataPlan([tmp_path]))


@pytest.mark.torch
def test_the_command_after_training_repeats_the_options_of_the_model(robustflow, monkeypatch, tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.training import session

    monkeypatch.setattr(session, "run_training", lambda request, stop: request.output / "last.pth")
    given = ["-O", "scaling=minus_one_one", "-O", "order=bgr", "-O", "note=two words"]
    assert "iterations: none instead of 12" in robustflow.prints(
        "train", "my.nets:Net", "--like", "raft", "--recipe", "kitti", "-d", tmp_path, "--plan"
    )
    assert "--like:" in robustflow.refuses("train", "my.nets:Net", "--recipe", "kitti")
    train = ("train", "my.nets:Net", "--like", "tiny", "--recipe", "shapes")
    command = shlex.split(robustflow.prints(*train, *given, "-o", tmp_path).partition("measure it with: ")[2])
    assert command == ["robustflow", "run", "--model", "my.nets:Net", *given, "--checkpoint", f"{tmp_path}/last.pth"]

"""A dataset of textured training pairs, and a request for training on it."""

from dataclasses import fields
from pathlib import Path

import pytest

from .chairs import write_chairs


@pytest.fixture(scope="session")
def chairs(tmp_path_factory) -> Path:
    """A folder in FlyingChairs' layout with eight pairs of moving textures, all in the training split."""
    return write_chairs(tmp_path_factory.mktemp("flow"), 8, (160, 208))


@pytest.fixture
def request_for(chairs, tmp_path):
    """A request that trains RAFT-small for a few updates; keyword arguments change the recipe, its data or the
    request."""
    pytest.importorskip("torch", reason="needs the torch extra")
    pytest.importorskip("torchvision", reason="needs the torch extra")
    from robustflow.training.recipe import Recipe, load_recipe
    from robustflow.training.request import Checkpoints, DataPlan, Request

    def make(output: str = "training", **changes) -> Request:
        recipe = load_recipe(changes.pop("method", "raft_small"), "chairs")
        of_recipe = {"steps": 2, "batch": 2, "crop": (128, 144), "iterations": 2}
        of_recipe |= {key: changes.pop(key) for key in set(changes) & set(Recipe.model_fields) - {"start"}}
        of_data = {key: changes.pop(key) for key in set(changes) & {field.name for field in fields(DataPlan)}}
        data = DataPlan(**{"sources": [chairs], "loaders": 0, **of_data})
        settings = {"start": "random", "device": "cpu", "checkpoints": Checkpoints(2), **changes}
        return Request(recipe.changed(**of_recipe), data, tmp_path / output, **settings)

    return make

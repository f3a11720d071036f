"""A plan's memory estimate agrees with a count for a crop and a number of iterations that are not in the table."""

from __future__ import annotations

import pytest

from robustflow.training.plan import expected_memory, plan_text
from robustflow.training.recipe import load_recipe
from robustflow.training.request import DataPlan

pytestmark = pytest.mark.training


def test_memory_of_a_different_crop_is_estimated():
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    pytest.importorskip("torchvision", reason="needs the torch extra")
    from robustflow.training.losses.supervised import sequence_loss
    from robustflow.training.networks import load_network

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

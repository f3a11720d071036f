"""Measure the memory that training keeps for the backward pass of each method, for the table used by `train --plan`.

    python bench/training_memory.py [METHOD ...] > src/robustflow/training/memory.csv

For each method, the script counts the bytes of all distinct tensors, except weights, that autograd keeps after a
forward pass, for one pair at two crop sizes and with one and three iterations. The four counts determine four numbers:
the bytes kept for each pixel and for each pair of pixels, once and per iteration. The counts do not depend on the
device; half precision needs less memory.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from scipy.optimize import nnls

from robustflow.training.data.loader import Batch
from robustflow.training.network_with_loss import loss_of_batch
from robustflow.training.recipe import load_recipe, recipes_of, trained_methods
from robustflow.training.trained_network import load_network

CROPS, ITERATIONS = ((224, 224), (224, 336)), (1, 3)
"""Crops that are divisible into windows of 7 pixels at 1/8 resolution, so that no padding is counted."""

_SCALES = np.array([1e3, 1e-2, 1e3, 1e-2])


def kept_bytes(method: str, crop: tuple[int, int], iterations: int) -> tuple[int, int, int]:
    """Bytes kept for one pair, number of trained weights, and number of frozen weights."""
    recipe = load_recipe(method, list(recipes_of(method))[-1])
    recipe = recipe.changed(crop=crop, batch=1, iterations=iterations, precision="fp32", devices=1)
    _, network = load_network(recipe, "random")
    network.train()
    weights = {value.untyped_storage().data_ptr() for value in [*network.parameters(), *network.buffers()]}
    kept: dict[int, torch.UntypedStorage] = {}

    def keep(tensor: torch.Tensor) -> torch.Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in weights:
            kept[storage.data_ptr()] = storage  # kept alive, so that no other tensor reuses its address
        return tensor

    images = torch.rand(2, 1, 3, *crop) * 255
    noise = torch.randn(1, 2, crop[0] // 8, crop[1] // 8)
    flow = torch.zeros(1, 2, *crop)
    batch = Batch(images[0], images[1], flow, flow[:, 0] + 1, ("",), time=500, noise=noise)
    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        loss_of_batch(network, batch, recipe)
    learning = sum(value.numel() for value in network.parameters() if value.requires_grad)
    rest = sum(value.numel() for value in network.parameters()) - learning
    return sum(storage.nbytes() for storage in kept.values()), learning, rest


def row(method: str) -> str:
    """Format a row of the table."""
    counts, terms, learning, rest = [], [], 0, 0
    for crop in CROPS:
        for iterations in ITERATIONS:
            number, learning, rest = kept_bytes(method, crop, iterations)
            pixels = crop[0] * crop[1]
            counts.append(number)
            terms.append([pixels, pixels**2, iterations * pixels, iterations * pixels**2])
    weights = 1 / np.array(counts, float)
    solved, _ = nnls(np.array(terms, float) * weights[:, None] * _SCALES, np.ones(len(counts)))
    solved *= _SCALES
    return ",".join([method, str(learning), str(rest), *(f"{value:.6g}" if value > 1e-9 else "0" for value in solved)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("methods", nargs="*", metavar="METHOD", help="by default all that are trained with labels only")
    methods = parser.parse_args().methods
    torch.set_num_threads(1)
    print("method,learning,frozen,pixel,pixel_pair,iteration_pixel,iteration_pixel_pair")
    labelled = [name for name in trained_methods() if all(one.objective is None for one in recipes_of(name).values())]
    for name in methods or labelled:
        print(row(name), flush=True)


if __name__ == "__main__":
    main()

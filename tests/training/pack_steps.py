"""Load a pack of training steps (`parity/training_*` in the shared data), and compute the same steps from its batch and
weights with the recipe's loss, optimiser and schedule.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from robustflow.media.images import read_image
from robustflow.training import network_with_loss
from robustflow.training.data.loader import Batch
from robustflow.training.optimization import build_optimizer, rate_of, set_rate
from robustflow.training.recipe import Recipe
from robustflow.training.trained_network import TrainedNetwork, learning_parameters, load_network

from ..parity.weight_rule import digest, weights
from ..shared_data import shared_root

NO_PACK = "none"
"""The case of a pack that is missing; its test is skipped with a reason."""


def cases_of(name: str) -> dict[str, dict[str, Any]]:
    """The cases stated by the pack `training_NAME`, by name."""
    path = shared_root() / "parity" / f"training_{name}" / "cases.json"
    if not path.is_file():
        return {NO_PACK: {}}
    cases: dict[str, dict[str, Any]] = json.loads(path.read_text())["cases"]
    return cases


@dataclass(frozen=True)
class TrainingPack:
    """A folder with `cases.json` and `expected.npz`."""

    folder: Path
    header: dict[str, Any]
    arrays: dict[str, np.ndarray]

    @classmethod
    @cache
    def read(cls, folder: Path) -> TrainingPack:
        with np.load(folder / "expected.npz") as file:
            return cls(folder, json.loads((folder / "cases.json").read_text()), dict(file))

    @property
    def items(self) -> tuple[str, ...]:
        return tuple(str(item) for item in range(len(list(self.folder.glob("item*_1.png")))))

    def frames(self, which: int) -> Tensor:
        """First (1) or second (2) frames, float32 (N, 3, H, W) in 0..255."""
        images = [read_image(self.folder / f"item{item}_{which}.png") for item in self.items]
        return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float()

    def batch(self, step: int = 0, times: list[int] | None = None) -> Batch:
        """The batch of a step, including the noise step and the noise if the case has `times`."""
        with np.load(self.folder / "truth.npz") as file:
            truth, valid = (torch.from_numpy(file[key]).float() for key in ("flow", "valid"))
        batch = Batch(self.frames(1), self.frames(2), truth, valid, self.items)
        if times is None:
            return batch
        rule = r"numpy\.random\.default_rng\((\d+) \+ step\)\.standard_normal\(\(([\d, ]+)\)\)\.astype\(float32\)"
        stated = re.fullmatch(rule, self.header["noise"])
        assert stated
        shape = tuple(map(int, stated[2].split(",")))
        noise = np.random.default_rng(int(stated[1]) + step).standard_normal(shape).astype(np.float32)
        return replace(batch, time=times[step], noise=torch.from_numpy(noise))

    def network(self, recipe: Recipe) -> TrainedNetwork:
        """The recipe's network in training mode, with the pack's weights."""
        torch.set_num_threads(1)
        made = weights(self.folder / "keys.json")
        assert digest(made) == self.header["digest"]
        _, network = load_network(recipe, "random")
        own = network.weights()
        assert own.keys() == {entry["key"] for entry in json.loads((self.folder / "keys.json").read_text())["entries"]}
        network.load_weights(own | {key: torch.from_numpy(value) for key, value in made.items()})
        return network.train()


@dataclass
class Step:
    """Results of one step before the weights change; gradients (before clipping) only for the first step."""

    loss: float
    norm: float
    rate: float
    numbers: dict[str, float]
    flows: list[Tensor]
    gradients: dict[str, Tensor]


def steps(
    network: TrainedNetwork,
    recipe: Recipe,
    batch_of: Callable[[int], Any],
    count: int,
    loss_of: Callable[[Any], tuple[Tensor, dict[str, float]]] | None = None,
) -> Iterator[Step]:
    """Compute steps with the optimiser, clipping and schedule of a recipe.

    Args:
        network: network from `TrainingPack.network`.
        recipe: recipe of a training run with as many steps as the pack's schedule.
        batch_of: function that returns the batch of a step.
        count: number of steps.
        loss_of: function that returns the loss of a batch; by default the recipe's loss.
    """
    loss_of = loss_of or (lambda batch: network_with_loss.loss_of_batch(network, batch, recipe))
    optimizer = build_optimizer(network, recipe)
    for number in range(count):
        rate = rate_of(recipe, number)
        set_rate(optimizer, rate)
        optimizer.zero_grad(set_to_none=True)
        with flows_kept() as flows:
            loss, numbers = loss_of(batch_of(number))
        loss.backward()
        gradients = {} if number else gradients_of(network)
        norm = nn.utils.clip_grad_norm_(learning_parameters(network), recipe.optimizer.clip or float("inf"))
        optimizer.step()
        yield Step(loss.item(), norm.item(), rate, numbers, [flow.detach() for flow in flows], gradients)


@contextmanager
def flows_kept() -> Iterator[list[Tensor]]:
    """Within the block, record the predictions that are passed to the sequence loss."""
    kept: list[Tensor] = []
    real = network_with_loss.sequence_loss

    def watched(flows: list[Tensor], *rest: Any) -> Tensor:
        kept[:] = flows
        return real(flows, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_with_loss, "sequence_loss", watched)
        yield kept


def gradients_of(network: TrainedNetwork) -> dict[str, Tensor]:
    """Copies of all existing gradients, keyed by the parameter names in the authors' files."""
    return {
        name.removeprefix("net.").removeprefix("model."): value.grad.clone()
        for name, value in network.named_parameters()
        if value.grad is not None
    }

"""The optimisers of the recipes."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import nn

from .recipe import Recipe


def build_optimizer(network: nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Create the recipe's optimiser for all trained parameters.

    In the RAFT family, AdamW applies weight decay to every parameter, including norms and biases; a recipe with
    `decay_biases = false` (ARFlow) exempts biases.
    """
    settings = recipe.optimizer
    learning = [(name, value) for name, value in network.named_parameters() if value.requires_grad]
    groups: list[dict[str, object]]
    if settings.decay_biases:
        groups = [{"params": [value for _, value in learning], "weight_decay": settings.weight_decay}]
    else:
        groups = [
            {"params": list(_ending(learning, bias=False)), "weight_decay": settings.weight_decay},
            {"params": list(_ending(learning, bias=True)), "weight_decay": 0.0},
        ]
    kind = {"adamw": torch.optim.AdamW, "adam": torch.optim.Adam}[settings.name]
    return kind(groups, lr=recipe.learning_rate, betas=settings.betas, eps=settings.eps, amsgrad=settings.amsgrad)


def set_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate of every parameter group."""
    for group in optimizer.param_groups:
        group["lr"] = rate


def _ending(named: list[tuple[str, nn.Parameter]], bias: bool) -> Iterable[nn.Parameter]:
    return (value for name, value in named if name.endswith("bias") == bias)

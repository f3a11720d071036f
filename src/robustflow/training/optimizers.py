"""The optimisers of the recipes."""

from __future__ import annotations

import torch
from torch import nn

from .recipe import Recipe


def build_optimizer(network: nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Create the recipe's optimiser for all trained parameters."""
    settings = recipe.optimizer
    learning = [(name, value) for name, value in network.named_parameters() if value.requires_grad]
    biases = [value for name, value in learning if name.endswith("bias") and not settings.decay_biases]
    others = [value for name, value in learning if not name.endswith("bias") or settings.decay_biases]
    groups = [{"params": others, "weight_decay": settings.weight_decay}]
    if biases:
        groups.append({"params": biases, "weight_decay": 0.0})
    kind = {"adamw": torch.optim.AdamW, "adam": torch.optim.Adam}[settings.name]
    return kind(groups, lr=recipe.learning_rate, betas=settings.betas, eps=settings.eps, amsgrad=settings.amsgrad)


def set_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate of every parameter group."""
    for group in optimizer.param_groups:
        group["lr"] = rate

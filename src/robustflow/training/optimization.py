"""The optimisers of the recipes, and learning rates that depend only on the update, so that resuming needs no schedule
state.
"""

from __future__ import annotations

import torch
from torch import nn

from ..core.errors import UsageError
from .recipe import Recipe

_EXTRA_UPDATES = 100
"""Number of updates by which RAFT's schedule exceeds the training run, so that its end is never reached."""
_RISING_SHARE = 0.05
_FIRST_DIVISOR, _LAST_DIVISOR = 25.0, 1e4


def one_cycle(update: int, steps: int, highest: float) -> float:
    """Return the learning rate of an update: linear `torch.optim.lr_scheduler.OneCycleLR` over `steps` + 100 updates,
    increasing during the first 5 %, as in RAFT and its successors.
    """
    total = steps + _EXTRA_UPDATES
    if not 0 <= update < total:
        raise UsageError(f"update {update} is outside a schedule of {total} updates")
    first, top = highest / _FIRST_DIVISOR, _RISING_SHARE * total - 1
    last, end = first / _LAST_DIVISOR, total - 1
    if update <= top:
        return first + (highest - first) * update / top
    return highest + (last - highest) * (update - top) / (end - top)


def constant(update: int, steps: int, highest: float) -> float:
    """Return a constant learning rate (ARFlow, UPFlow)."""
    return highest


def constant_then_decay(update: int, steps: int, highest: float) -> float:
    """Return a learning rate that is constant at first and decays exponentially to a thousandth over the last fifth of
    the updates (BrightFlow: the last 15 000 of 75 000).

    >>> [f"{constant_then_decay(update, 75_000, 2e-4):.4g}" for update in (60_000, 67_500, 74_999)]
    ['0.0002', '6.325e-06', '2.001e-07']
    """
    falling = steps // 5
    past = update - (steps - falling)
    return highest if past <= 0 else highest * 1e-3 ** (past / falling)


SCHEDULES = {"one_cycle": one_cycle, "constant": constant, "constant_then_decay": constant_then_decay}
"""Schedules by the name used in recipes."""


def rate_of(recipe: Recipe, update: int) -> float:
    """Return the learning rate of an update, counted from 0, for a recipe."""
    steps = recipe.updates - recipe.extra_update
    return SCHEDULES[recipe.schedule](update + recipe.schedule_ahead, steps, recipe.learning_rate)


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

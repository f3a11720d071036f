"""Normal noise that is a function of what it is for."""

from __future__ import annotations

import torch
from torch import Tensor

from ..random.rng import key_of


def normal(name: tuple[str | int, ...], like: Tensor) -> Tensor:
    """Standard normal numbers of the shape of `like`, on the CPU; the same for the same name."""
    generator = torch.Generator().manual_seed(key_of(*name) % 2**63)
    return torch.randn(like.shape, generator=generator)

"""UPFlow's unsupervised loss (Luo et al., CVPR 2021), with the weights and terms of the authors' code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor

from ...models.torch.resize import resize_flow
from ..objectives import UpflowObjective
from .photometric import census_sum, robust
from .smoothness import steps


@dataclass(frozen=True)
class OneWay:
    """One direction of a pair."""

    flow: Tensor
    levels: Sequence[Tensor]
    image: Tensor
    warped: Tensor
    seen: Tensor


def upflow_terms(ways: Sequence[OneWay], settings: UpflowObjective) -> dict[str, Tensor]:
    """Return the weighted terms of the loss, each a scalar, summed over both directions."""
    q = settings.exponent
    return {
        "photometric": _sum(settings.photometric * robust(way.image - way.warped, q).mean() for way in ways),
        "census": _sum(
            settings.census * robust(census_sum(way.image, way.warped, settings.radius), q).mean() for way in ways
        ),
        "smoothness": _sum(settings.smooth * edge_aware(way.flow, way.image) for way in ways),
        "distillation": _sum(settings.distillation * distillation(way, q) for way in ways),
    }


def distillation(way: OneWay, exponent: float = 0.4) -> Tensor:
    """Return the distance between the enlarged flow of each level and the final flow at visible pixels; a scalar."""
    height, width = way.flow.shape[2:]
    teacher, count = way.flow.detach(), way.seen.sum() + 1e-6
    far = [robust(resize_flow(level, (height, width)) - teacher, exponent) for level in way.levels]
    return _sum((one * way.seen).sum() / count for one in far)


def edge_aware(flow: Tensor, image: Tensor) -> Tensor:
    """Return the sum, over x and y, of the mean of |flow differences| times exp(-mean |image differences|)."""
    edges = ((-step.abs().mean(dim=1, keepdim=True)).exp() for step in steps(image))
    along_x, along_y = (step.abs() * weight for step, weight in zip(steps(flow), edges, strict=True))
    return along_x.mean() + along_y.mean()


def _sum(terms: Iterable[Tensor]) -> Tensor:
    return reduce(torch.add, terms)

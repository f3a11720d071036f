"""UPFlow's loss without labels (Luo et al., CVPR 2021), with the weights and forms of its authors' network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from torch import Tensor

from ...models.torch.resize import resize_flow
from ..objectives import UpflowObjective
from .photometric import census_sum, robust


@dataclass(frozen=True)
class OneWay:
    """One direction of a pair.

    Attributes:
        flow: (N, 2, H, W), pixels.
        levels: flows of the pyramid, each in pixels at its level.
        image: (N, 3, H, W), the frame that the flow starts from, as the network takes it.
        warped: (N, 3, H, W), the other frame, warped to this one by the flow.
        seen: float (N, 1, H, W), 0 where another object hides the pixel.
    """

    flow: Tensor
    levels: Sequence[Tensor]
    image: Tensor
    warped: Tensor
    seen: Tensor


def upflow_terms(ways: Sequence[OneWay], settings: UpflowObjective) -> dict[str, Tensor]:
    """The loss' terms with their weights, each a scalar, sums over both directions.

    The photometric terms have no mask. The census compares grey values of about -0.5..0.6, and not of 0..255 as
    elsewhere, like the original.
    """
    q = settings.exponent
    return {
        "photometric": _sum(settings.photometric * robust(way.image - way.warped, q).mean() for way in ways),
        "census": _sum(
            settings.census * robust(census_sum(way.image, way.warped, settings.radius, levels=1.0), q).mean()
            for way in ways
        ),
        "smoothness": _sum(settings.smooth * edge_aware(way.flow, way.image) for way in ways),
        "distillation": _sum(settings.distillation * distillation(way, q) for way in ways),
    }


def distillation(way: OneWay, exponent: float = 0.4) -> Tensor:
    """How far the enlarged flow of each level is from the final one, where it is visible; a scalar.

    No gradient goes into the final flow, which is the teacher ("upup" of the original).
    """
    height, width = way.flow.shape[2:]
    teacher, count = way.flow.detach(), way.seen.sum() + 1e-6
    far = [robust(resize_flow(level, (height, width)) - teacher, exponent) for level in way.levels]
    return _sum((one * way.seen).sum() / count for one in far)


def edge_aware(flow: Tensor, image: Tensor) -> Tensor:
    """The mean of |flow differences| times exp(-mean |image differences|) along x, and along y; their sum.

    Args:
        flow: (N, 2, H, W), pixels.
        image: (N, C, H, W).
    """
    weight_x = (-(image[..., 1:] - image[..., :-1]).abs().mean(dim=1, keepdim=True)).exp()
    weight_y = (-(image[..., 1:, :] - image[..., :-1, :]).abs().mean(dim=1, keepdim=True)).exp()
    along_x = (flow[..., 1:] - flow[..., :-1]).abs() * weight_x
    along_y = (flow[..., 1:, :] - flow[..., :-1, :]).abs() * weight_y
    return along_x.mean() + along_y.mean()


def _sum(terms: Iterable[Tensor]) -> Tensor:
    first, *others = terms
    for other in others:
        first = first + other
    return first

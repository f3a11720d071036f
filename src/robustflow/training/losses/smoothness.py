"""Edge-aware smoothness of a flow: its spatial differences, with lower weights at image edges."""

from __future__ import annotations

from torch import Tensor


def smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """Return the mean weighted difference of neighbouring flow vectors, a scalar scaled as in ARFlow."""
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in steps(image))
    x, y = steps(flow)
    if second_order:
        x, y = steps(x)[0], steps(y)[1]
        weight_x, weight_y = weight_x[:, :, :, 1:], weight_y[:, :, 1:]
    else:
        x, y = x / 2, y / 2
    return (weight_x * x.abs()).mean() / 2 + (weight_y * y.abs()).mean() / 2


def robust_smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """Return BrightFlow's smoothness, a scalar: sqrt(d^2 + 0.001^2) of each difference d, summed over both
    components.
    """
    x, y = steps(flow)
    if second_order:
        x, y = steps(x)[0], steps(y)[1]
        edges = image[:, :, :, 2:] - image[:, :, :, :-2], image[:, :, 2:] - image[:, :, :-2]
    else:
        edges = steps(image)
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in edges)
    along_x, along_y = (weight_x * charbonnier(x)).sum(dim=1).mean(), (weight_y * charbonnier(y)).sum(dim=1).mean()
    return (along_x + along_y) / 2


def charbonnier(differences: Tensor) -> Tensor:
    """Return sqrt(x^2 + 0.001^2), a smooth absolute value."""
    return (differences.square() + 1e-6).sqrt()


def steps(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Return the differences of neighbours along x and along y."""
    return maps[:, :, :, 1:] - maps[:, :, :, :-1], maps[:, :, 1:] - maps[:, :, :-1]

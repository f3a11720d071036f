"""Edge-aware smoothness of a flow: its differences, weighted down where the image has edges."""

from __future__ import annotations

from torch import Tensor


def smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """The mean weighted difference of neighbouring flow vectors, a scalar (ARFlow's, with its factors).

    Args:
        flow: (N, 2, H, W).
        image: (N, C, H, W), in 0..1.
        alpha: an edge of height g weighs exp(-alpha g).
        second_order: differences of differences instead, which are zero for affine motion.
    """
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in _steps(image))
    x, y = _steps(flow)
    if second_order:
        x, y = _steps(x)[0], _steps(y)[1]
        weight_x, weight_y = weight_x[:, :, :, 1:], weight_y[:, :, 1:]
    else:
        x, y = x / 2, y / 2
    return (weight_x * x.abs()).mean() / 2 + (weight_y * y.abs()).mean() / 2


def robust_smoothness(flow: Tensor, image: Tensor, alpha: float, second_order: bool) -> Tensor:
    """BrightFlow's smoothness: sqrt(d^2 + 0.001^2) of each difference d, summed over both components; a scalar.

    Second differences are weighted by the edge between the outer two of their three pixels. Arguments as for
    `smoothness`; the flow is in pixels, the image in the range that alpha is for.
    """
    x, y = _steps(flow)
    if second_order:
        x, y = _steps(x)[0], _steps(y)[1]
        edges = image[:, :, :, 2:] - image[:, :, :, :-2], image[:, :, 2:] - image[:, :, :-2]
    else:
        edges = _steps(image)
    weight_x, weight_y = ((-alpha * step.abs().mean(dim=1, keepdim=True)).exp() for step in edges)
    along_x, along_y = (weight_x * charbonnier(x)).sum(dim=1).mean(), (weight_y * charbonnier(y)).sum(dim=1).mean()
    return (along_x + along_y) / 2


def charbonnier(differences: Tensor) -> Tensor:
    """sqrt(x^2 + 0.001^2), an absolute value with a gradient at 0."""
    return (differences.square() + 1e-6).sqrt()


def _steps(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Differences of neighbours along x and along y."""
    return maps[:, :, :, 1:] - maps[:, :, :, :-1], maps[:, :, 1:] - maps[:, :, :-1]

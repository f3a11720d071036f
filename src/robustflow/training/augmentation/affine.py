"""Apply ARFlow's geometric transforms to a pair with predicted flow: both frames are transformed, the second one
slightly more (Liu et al., CVPR 2020, Sec. 3.3, with the transform of Hur and Roth, IRR, CVPR 2019).

A transform is a 3x3 matrix that maps frame coordinates in -1..1 to coordinates in the transformed frame.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from ...core.errors import UsageError
from ...core.rng import Rng
from ...models.networks.blocks.correlation import pixel_grid
from ..recipe import Range, Spatial

Matrix = npt.NDArray[Any]

_CORNERS = np.array([[-1, -1, 1, 1], [-1, 1, -1, 1], [1, 1, 1, 1]], np.float64)
_ATTEMPTS = 10_000


class Moves(NamedTuple):
    """A randomly drawn transform for each of the two frames."""

    first: Matrix
    second: Matrix


def draw_moves(rng: Rng, settings: Spatial, shape: tuple[int, int]) -> Moves:
    """Draw both transforms such that the transformed frames of `shape` (H, W) contain no pixels from outside the
    original frames.
    """
    of_both = (settings.translation, settings.zoom, settings.squeeze, settings.rotation)
    rotation = settings.relative_rotation
    if settings.constant_rotation:
        rotation = (rotation[0], rotation[0])
    besides = (settings.relative_translation, settings.relative_zoom, settings.relative_squeeze, rotation)
    first = _inside(rng, np.eye(3), *of_both, shape)
    second = _inside(rng, first, *besides, shape)
    flips = np.eye(3)
    if settings.horizontal and rng.uniform() < 0.5:
        flips[0, 0] = -1
    if settings.vertical and rng.uniform() < 0.5:
        flips[1, 1] = -1
    return Moves(flips @ first, flips @ second)


def moved(maps: Tensor, moves: list[Matrix]) -> Tensor:
    """Transform each map (N, C, H, W) with bilinear sampling; pixels from outside the map are 0."""
    height, width = maps.shape[2:]
    back = _tensor([np.linalg.inv(move) for move in moves], maps)
    grid = F.affine_grid(back, [len(moves), 1, height, width], align_corners=True)
    x, y = (grid[..., 0] + 1) / 2 * (width - 1), (grid[..., 1] + 1) / 2 * (height - 1)
    inside = ((x >= 0) & (x < width) & (y >= 0) & (y < height))[:, None].to(maps.dtype)
    return F.grid_sample(maps, grid, mode="bilinear", padding_mode="border", align_corners=True) * inside


def moved_flow(flow: Tensor, moves: list[Moves]) -> Tensor:
    """Return the flow between the transformed frames, (N, 2, H, W), in pixels."""
    start = pixel_grid(flow)
    first, second = _tensor([move.first for move in moves], flow), _tensor([move.second for move in moves], flow)
    turned = _applied(second, start + flow) - _applied(first, start)
    return moved(turned, [move.first for move in moves])


def _inside(
    rng: Rng,
    before: Matrix,
    translation: float,
    zoom: Range,
    squeeze: Range,
    rotation: Range,
    shape: tuple[int, int],
) -> Matrix:
    """Draw a transform and apply it after `before`; redraw until the corners of the result come from inside the
    frame."""
    for _ in range(_ATTEMPTS):
        larger, wider = rng.uniform(*zoom), rng.uniform(*squeeze)
        x, y = (rng.uniform(-translation / 2, translation / 2) for _ in range(2))
        angle = rng.uniform(*rotation)
        along_x, along_y = larger * wider, larger / wider
        sine, cosine = math.sin(angle), math.cos(angle)
        step = np.array([[cosine * along_x, sine * along_y, x], [-sine * along_x, cosine * along_y, y], [0, 0, 1]])
        candidate = step @ before
        corners = np.linalg.inv(candidate) @ _CORNERS
        side = np.array([[shape[1]], [shape[0]]])
        places = 0.5 * (side - 1) * (corners[:2] + 1)
        if (places >= 0).all() and (places < side).all():
            return candidate
    raise UsageError(
        f"in {_ATTEMPTS} draws, every transform of the second pass extended beyond the frame; increase the zoom or "
        "reduce the motion"
    )


def _applied(moves: Tensor, points: Tensor) -> Tensor:
    """Transform points (N, 2, H, W), in pixels, by matrices (N, 2, 3)."""
    height, width = points.shape[2:]
    half = points.new_tensor([(width - 1) / 2, (height - 1) / 2]).view(1, 2, 1, 1)
    turned = torch.einsum("nij,njhw->nihw", moves[:, :, :2], points / half - 1) + moves[:, :, 2, None, None]
    return (turned + 1) * half


def _tensor(moves: list[Matrix], like: Tensor) -> Tensor:
    return torch.from_numpy(np.stack(moves)[:, :2]).to(like.device, like.dtype)

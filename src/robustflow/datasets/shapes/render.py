"""A scene as frames, flow and occlusion, in compiled loops over the pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...sample import DepthMap, Flow, Frame, Mask
from .motion import backward, forward
from .outline import inset
from .scene import Scene

_NEAREST, _FARTHEST = 5.0, 100.0
"""Metres of the first layer and of the background."""


def render_pair(scene: Scene) -> tuple[tuple[Frame, Frame], Flow, Mask]:
    """Both frames, the flow of the uppermost layer at each pixel of the first, and where that point is hidden in the
    second.

    Returns:
        Frames RGB uint8 (H, W, 3), flow float32 (H, W, 2) in pixels, and the occlusion map, bool (H, W): the point is
        covered by a layer above its own, or outside the second frame, that is beyond the centres of its outer pixels.
    """
    height, width = scene.shape
    grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
    points = grid.reshape(-1, 2)
    flow, occluded = flow_at(scene, points)
    frames = [np.rint(colours_at(scene, points, which)).astype(np.uint8).reshape(height, width, 3) for which in (0, 1)]
    return (frames[0], frames[1]), flow.astype(np.float32).reshape(height, width, 2), occluded.reshape(height, width)


def colours_at(scene: Scene, points: npt.NDArray[np.float64], which: int) -> npt.NDArray[np.float64]:
    """The colours at any points of frame 0 or 1, also between pixels, before rounding.

    Args:
        scene: the scene to render.
        points: (N, 2), (x, y) in pixels.
        which: 0 or 1.

    Returns:
        float64 (N, 3), 0..255.
    """
    out = np.empty((len(points), 3))
    _colours(points, which, scene.motions, scene.outlines, scene.fills, scene.chosen, scene.textures, out)
    return out


def flow_at(scene: Scene, points: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], Mask]:
    """Flow float64 (N, 2) and occlusion bool (N,) at any points (x, y) of frame 1, float64 (N, 2)."""
    flow, occluded = np.empty((len(points), 2)), np.empty(len(points), bool)
    _flows(points, scene.motions, scene.outlines, *scene.shape, flow, occluded)
    return flow, occluded


def depths_of(scene: Scene) -> tuple[DepthMap, DepthMap]:
    """The depth of the uppermost layer at each pixel of both frames, float32 (H, W), metres (`layer_depths`)."""
    of_layers = layer_depths(len(scene.motions))
    first, second = (np.empty(scene.shape, np.float32) for _ in range(2))
    for which, out in enumerate((first, second)):
        _depths(which, scene.motions, scene.outlines, of_layers, out)
    return first, second


def layer_depths(count: int) -> npt.NDArray[np.float32]:
    """The depths of layers from front to back, metres: from 5 to 100, evenly spaced in inverse depth.

    >>> layer_depths(3).tolist()
    [5.0, 9.523809432983398, 100.0]
    """
    place = np.arange(count) / max(count - 1, 1)
    return (1.0 / ((1.0 - place) / _NEAREST + place / _FARTHEST)).astype(np.float32)


@njit(cache=True, nogil=True)
def _covers_near(outline: Any, motion: Any, which: Any, x: Any, y: Any) -> Any:
    """False if a point is certainly outside a layer: tested by a circle, so that most layers cost next to nothing."""
    if outline[7] < 0.0:
        return True
    if which == 0:
        dx, dy, reach = x - outline[0], y - outline[1], motion[20]
    else:
        dx, dy, reach = x - motion[22], y - motion[23], motion[21]
    return dx * dx + dy * dy <= reach * reach


@njit(cache=True, nogil=True)
def _colours(
    points: Any, which: Any, motions: Any, outlines: Any, fills: Any, chosen: Any, textures: Any, out: Any
) -> None:
    size = textures.shape[1]
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        left = 1.0
        out[i, 0], out[i, 1], out[i, 2] = 0.0, 0.0, 0.0
        for layer in range(motions.shape[0]):
            if not _covers_near(outlines[layer], motions[layer], which, x, y):
                continue
            mx, my = x, y
            if which == 1:
                mx, my = backward(motions[layer], x, y)
            inside = inset(outlines[layer], mx, my)
            if inside <= -0.5:
                continue
            share = left * min(inside + 0.5, 1.0)
            fill = fills[layer]
            u = fill[0] * mx + fill[1] * my + fill[2]
            v = fill[3] * mx + fill[4] * my + fill[5]
            column, row = np.floor(u), np.floor(v)
            u, v = u - column, v - row
            c0, r0 = int(column) % size, int(row) % size
            c1, r1 = (c0 + 1) % size, (r0 + 1) % size
            texture = textures[chosen[layer]]
            for channel in range(3):
                above = texture[r0, c0, channel] * (1.0 - u) + texture[r0, c1, channel] * u
                below = texture[r1, c0, channel] * (1.0 - u) + texture[r1, c1, channel] * u
                value = fill[9 + channel] + fill[6 + channel] * (above * (1.0 - v) + below * v)
                out[i, channel] += share * min(max(value, 0.0), 255.0)
            left -= share
            if left <= 0.0:
                break


@njit(cache=True, nogil=True)
def _flows(points: Any, motions: Any, outlines: Any, height: Any, width: Any, flow: Any, occluded: Any) -> None:
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        top = 0
        while not (_covers_near(outlines[top], motions[top], 0, x, y) and inset(outlines[top], x, y) > 0.0):
            top += 1
        qx, qy = forward(motions[top], x, y)
        flow[i, 0], flow[i, 1] = qx - x, qy - y
        hidden = not (0.0 <= qx <= width - 1 and 0.0 <= qy <= height - 1)
        for layer in range(top):
            if hidden:
                break
            if _covers_near(outlines[layer], motions[layer], 1, qx, qy):
                mx, my = backward(motions[layer], qx, qy)
                hidden = inset(outlines[layer], mx, my) > 0.0
        occluded[i] = hidden


@njit(cache=True, nogil=True)
def _depths(which: Any, motions: Any, outlines: Any, of_layers: Any, out: Any) -> None:
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            x, y = float(column), float(row)
            top = 0
            while True:
                if _covers_near(outlines[top], motions[top], which, x, y):
                    mx, my = x, y
                    if which == 1:
                        mx, my = backward(motions[top], x, y)
                    if inset(outlines[top], mx, my) > 0.0:
                        break
                top += 1
            out[row, column] = of_layers[top]

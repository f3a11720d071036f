"""Render a scene's frames, flow and occlusion in compiled loops over the pixels.

With a rolling shutter, row y of frame k (0 or 1) is captured at time k + readout ((y + 1/2) / H - 1/2). The flow ends
at the position of the same scene point in the second frame, at the capture time of its row.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ....core.compiled import inner, njit
from ....core.types import DepthMap, Flow, Frame, Mask
from .scene import Scene, at_time, from_time, inset

_NEAREST, _FARTHEST = 5.0, 100.0
"""Depth of the front layer and of the background, in metres."""


def render_pair(scene: Scene, readout: float = 0.0) -> tuple[tuple[Frame, Frame], Flow, Mask]:
    height, width = scene.shape
    grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
    points = grid.reshape(-1, 2)
    flow, occluded = flow_at(scene, points, readout)
    first, second = (
        np.rint(colours_at(scene, points, which, readout)).astype(np.uint8).reshape(height, width, 3)
        for which in (0, 1)
    )
    return (first, second), flow.astype(np.float32).reshape(height, width, 2), occluded.reshape(height, width)


def colours_at(
    scene: Scene, points: npt.NDArray[np.float64], which: int, readout: float = 0.0
) -> npt.NDArray[np.float64]:
    """Return the colours at arbitrary subpixel positions of frame 0 or 1, before rounding."""
    out = np.empty((len(points), 3))
    layers = scene.motions, scene.outlines, scene.fills, scene.chosen, scene.textures
    _colours(points, float(which), float(readout), float(scene.shape[0]), *layers, out)
    return out


def flow_at(
    scene: Scene, points: npt.NDArray[np.float64], readout: float = 0.0
) -> tuple[npt.NDArray[np.float64], Mask]:
    """Return flow, float64 (N, 2), and occlusion, bool (N,), at arbitrary points (x, y) of frame 1, float64 (N, 2)."""
    flow, occluded = np.empty((len(points), 2)), np.empty(len(points), bool)
    _flows(points, float(readout), scene.motions, scene.outlines, *map(float, scene.shape), flow, occluded)
    return flow, occluded


def depths_of(scene: Scene, readout: float = 0.0) -> tuple[DepthMap, DepthMap]:
    of_layers = layer_depths(len(scene.motions))
    first, second = (np.empty(scene.shape, np.float32) for _ in range(2))
    for which, out in enumerate((first, second)):
        _depths(float(which), float(readout), scene.motions, scene.outlines, of_layers, out)
    return first, second


def layer_depths(count: int) -> npt.NDArray[np.float32]:
    """Return the depths of layers from front to back, in metres: from 5 to 100, evenly spaced in inverse depth."""
    place = np.arange(count) / max(count - 1, 1)
    return (1.0 / ((1.0 - place) / _NEAREST + place / _FARTHEST)).astype(np.float32)


@njit(cache=True, nogil=True, inline="always")
def _time(which: Any, readout: Any, y: Any, height: Any) -> Any:
    return which + readout * ((y + 0.5) / height - 0.5)


@inner
def _inside(outline: Any, motion: Any, t: Any, x: Any, y: Any) -> Any:
    """Return False if a point is outside a layer's bounding circle at time `t`; a cheap test that skips most layers."""
    if outline[7] < 0.0:
        return True
    dx, dy = x - (motion[0] + t * motion[2]), y - (motion[1] + t * motion[3])
    reach = abs(1.0 - t) * motion[20] + abs(t) * motion[21]
    return dx * dx + dy * dy <= reach * reach


@inner
def _inset_at(outline: Any, motion: Any, t: Any, x: Any, y: Any) -> Any:
    mx, my = from_time(motion, t, x, y)
    return inset(outline, mx, my)


@njit(cache=True, nogil=True)
def _colours(
    points: Any, which: Any, readout: Any, height: Any,
    motions: Any, outlines: Any, fills: Any, chosen: Any, textures: Any, out: Any,
) -> None:  # fmt: skip
    size = textures.shape[1]
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        t = _time(which, readout, y, height)
        left = 1.0
        out[i, 0], out[i, 1], out[i, 2] = 0.0, 0.0, 0.0
        for layer in range(motions.shape[0]):
            if not _inside(outlines[layer], motions[layer], t, x, y):
                continue
            mx, my = from_time(motions[layer], t, x, y)
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
def _flows(
    points: Any, readout: Any, motions: Any, outlines: Any, height: Any, width: Any, flow: Any, occluded: Any
) -> None:
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        t = _time(0.0, readout, y, height)
        top = 0
        while not (
            _inside(outlines[top], motions[top], t, x, y) and _inset_at(outlines[top], motions[top], t, x, y) > 0.0
        ):
            top += 1
        mx, my = from_time(motions[top], t, x, y)
        # The point and the row being read move at constant speeds: they meet once, possibly outside the frame.
        speed = at_time(motions[top], 1.0, mx, my)[1] - my
        closing = 1.0 - speed * readout / height
        row = (my + speed * _time(1.0, readout, 0.0, height)) / closing if closing != 0.0 else np.inf
        meeting = _time(1.0, readout, row, height) if readout > 0.0 else 1.0
        t = min(max(meeting, 1.0 - 0.5 * readout), 1.0 + 0.5 * readout)
        qx, qy = at_time(motions[top], t, mx, my)
        flow[i, 0], flow[i, 1] = qx - x, qy - y
        hidden = t != meeting or not (0.0 <= qx <= width - 1 and 0.0 <= qy <= height - 1)
        for layer in range(top):
            if hidden:
                break
            if _inside(outlines[layer], motions[layer], t, qx, qy):
                hidden = _inset_at(outlines[layer], motions[layer], t, qx, qy) > 0.0
        occluded[i] = hidden


@njit(cache=True, nogil=True)
def _depths(which: Any, readout: Any, motions: Any, outlines: Any, of_layers: Any, out: Any) -> None:
    for row in range(out.shape[0]):
        t = _time(which, readout, float(row), float(out.shape[0]))
        for column in range(out.shape[1]):
            top = 0
            x, y = float(column), float(row)
            while not (
                _inside(outlines[top], motions[top], t, x, y) and _inset_at(outlines[top], motions[top], t, x, y) > 0.0
            ):
                top += 1
            out[row, column] = of_layers[top]

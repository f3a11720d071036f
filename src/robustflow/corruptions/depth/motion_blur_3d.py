"""Depth-dependent motion blur: the average of views of the frame along the camera path."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.compiled import contiguous, inner, njit
from ...core.rng import Rng
from ...core.types import Camera, DepthMap, Frame, SceneDepth
from ..corruption import DepthCorruption
from ..kernels.packed import EIGHTHS, FRACTION, between, divide, mean, pack, reciprocals, until
from .scene import Motion, motion_of

_DRAWN = 0.03
"""For random camera motion: displacement of a point at the median depth, as a fraction of the image width.
"""
_EVERY = 16
"""Stride in pixels for estimating the median depth."""
_MOST = 40
"""Maximum number of views; on longer paths, the views are more than one pixel apart."""
_FEW = 6
"""Maximum number of views for which colours are interpolated between pixels."""
_HALF = 1 << (FRACTION - 1)
_FARTHEST = 2.0**14
"""Maximum displacement in pixels."""
_NEAREST = np.float32(1e-6)
"""Smallest depth in metres; closer points are treated as if they were at this depth."""
_FINE, _COARSE = 6, 3
"""Fractional bits of the end points of a horizontal path, for short and for longer paths."""
_SHORT, _LONG = 60 << FRACTION, 500 << FRACTION
"""Path lengths in fixed point: paths shorter than the first have end points with `_FINE` fractional bits; for paths
shorter than the second, a sum along the path fits in a word.
"""
_CELL_BITS = 2
_CELL = 1 << _CELL_BITS
"""Side of the cells, in pixels, in which a path is searched for nearer surfaces."""
_TILE = 16
"""Tile size in pixels; the nearest surface is stored per tile."""
_SAME = np.float32(0.9)
"""Two inverse depths belong to the same surface if their ratio (smaller to larger) is at least this value."""


class MotionBlurState(NamedTuple):
    path: Motion
    """Camera motion between the frames: a point X in camera coordinates becomes `rotation @ X + translation`."""
    share: float  # exposure time as a fraction of the time between the frames
    camera: Camera
    depth: tuple[DepthMap, DepthMap]  # depth maps of both frames, in metres


class MotionBlur3d(DepthCorruption):
    """Averages views along the camera path in both frames, so near surfaces are blurred more than far ones.

    The severity parameter is the exposure time as a fraction of the time between the frames; 0.5 is typical for film.
    Both exposures use the camera motion between the two frames. In camera coordinates, points move in straight lines at
    constant speed, and the exposure is centred on the time of the frame, so the content does not shift. Moving objects
    are blurred as if they were static. If the camera motion is unknown, a random one is drawn per pair: a translation
    in a direction uniformly distributed in space, which moves a point at the median depth of frame 1 by 3 % of the
    image width.

    The number of views is the path length in pixels plus one, at most 40. In each view, a pixel shows either the
    nearest surface that moves over it or its own surface; the colour is looked up in the frame (interpolated if the
    path is short). If no nearer surface is close to a horizontal path, the exact integral along the path replaces the
    views. Where the uncovered background is not visible in the frame, the mean of the pixel's known views is used or,
    if there are none, the pixel's own colour. Outside the image, edge pixels are repeated.
    """

    name = "motion_blur_3d"
    paper_severities = (0.1, 0.25, 0.5, 0.75, 1.0)

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> MotionBlurState:
        path = motion_of(depth.camera) or _draw_motion(rng, depth)
        return MotionBlurState(path, float(self.parameter(severity)), depth.camera, depth.maps)

    def apply(self, frame: Frame, state: MotionBlurState, index: int) -> Frame:
        frame = contiguous(frame)
        lens = np.array(state.camera.intrinsics(index), np.float64)
        # a point at depth Z on the ray (x, y, 1) moves by Z (turn @ ray + translation / Z)
        turn = state.path.rotation - np.eye(3)
        inverse = np.float32(1) / np.maximum(np.ascontiguousarray(state.depth[index]), _NEAREST)
        near = np.zeros((-(-frame.shape[0] // _TILE), -(-frame.shape[1] // _TILE)), np.float32)
        _spread_near(inverse, lens, turn, state.path.translation, state.share, near)
        out = np.empty_like(frame)
        _average(frame, inverse, near, lens, turn, state.path.translation, state.share, out)
        return out


def _draw_motion(rng: Rng, depth: SceneDepth) -> Motion:
    while True:
        x, y, z = (rng.uniform(-1.0, 1.0) for _ in range(3))
        squared = x * x + y * y + z * z
        if 0.01 < squared <= 1:
            break
    ordered = np.sort(depth.maps[0].reshape(-1)[::_EVERY])
    width = depth.maps[0].shape[1]
    # a sideways translation t moves a point by f t / Z pixels; a forward translation t moves a point that is a quarter
    # of the width W from the centre by (W / 4) t / Z pixels
    scale = float(ordered[ordered.size // 2]) * _DRAWN * width / float(np.sqrt(squared))
    along, down = depth.camera.focal
    return Motion(np.eye(3), np.array([scale * x / along, scale * y / down, scale * z * 4.0 / width]))


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _step(lens: Any, turn: Any, translation: Any, x: Any, y: Any, inverse: Any) -> Any:
    """Return (u, v) in pixels: after a fraction t of the path, (x, y) shows the frame's content at (x - t u, y - t
    v).
    """
    px, py = (x - lens[2]) / lens[0], (y - lens[3]) / lens[1]
    a = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] + translation[0] * inverse
    b = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] + translation[1] * inverse
    c = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] + translation[2] * inverse
    return lens[0] * (a - px * c), lens[1] * (b - py * c)


@inner
def _largest(values: Any, first: int, end: int) -> Any:
    """Return the largest of the values from `first` to `end`, or to the last; `max` would take a second to compile."""
    found = values[first]
    for i in range(first + 1, min(end, values.size)):
        found = max(found, values[i])
    return found


@inner
def _edges(inverse: Any, out: Any) -> None:
    """Compute the largest inverse depth among each tile's edge pixels, i.e. pixels next to a farther surface."""
    height, width = inverse.shape
    largest = np.empty(width, np.float32)
    for j in range(out.shape[0]):
        largest[:] = np.float32(0)
        for y in range(j * _TILE, min((j + 1) * _TILE, height)):
            above, row, below = inverse[max(y - 1, 0)], inverse[y], inverse[min(y + 1, height - 1)]
            for x in range(1, width - 1):
                farthest = min(min(above[x], below[x]), min(row[x - 1], row[x + 1]))
                largest[x] = max(largest[x], row[x] if farthest < _SAME * row[x] else np.float32(0))
            for x in (0, width - 1):
                farthest = min(min(above[x], below[x]), min(row[max(x - 1, 0)], row[min(x + 1, width - 1)]))
                largest[x] = max(largest[x], row[x] if farthest < _SAME * row[x] else np.float32(0))
        for i in range(out.shape[1]):
            out[j, i] = _largest(largest, i * _TILE, (i + 1) * _TILE)


@njit(cache=True, nogil=True)
def _spread_near(inverse: Any, lens: Any, turn: Any, translation: Any, share: float, near: Any) -> None:
    """Compute, for each tile, the largest inverse depth of any edge that enters it during the exposure (0 if none)."""
    height, width = inverse.shape
    edges = np.empty_like(near)
    _edges(inverse, edges)
    for j in range(near.shape[0]):
        for i in range(near.shape[1]):
            largest, across, down = edges[j, i], 0.0, 0.0
            if largest == 0:
                continue
            for y in (j * _TILE, min((j + 1) * _TILE, height)):  # the motion within a tile is largest at a corner
                for x in (i * _TILE, min((i + 1) * _TILE, width)):
                    u, v = _step(lens, turn, translation, float(x), float(y), float(largest))
                    across, down = max(across, abs(u)), max(down, abs(v))
            columns = np.int64(min(np.ceil(0.5 * share * across / _TILE), 1e6))
            rows = np.int64(min(np.ceil(0.5 * share * down / _TILE), 1e6))
            around = near[max(j - rows, 0) : j + rows + 1, max(i - columns, 0) : i + columns + 1]
            for t in range(around.shape[0]):
                for s in range(around.shape[1]):
                    around[t, s] = max(around[t, s], largest)


@inner
def _row_of_paths(
    inverse: Any, px: Any, py: Any, lens: Any, turn: Any, translation: Any, share: float, out: Any
) -> None:
    """Compute, for each pixel in a row, the fixed-point (x, y) displacement per view and the number of views."""
    f = np.float32
    a0, a1, a2 = f(turn[0, 1] * py + turn[0, 2]), f(turn[0, 0]), f(translation[0])
    b0, b1, b2 = f(turn[1, 1] * py + turn[1, 2]), f(turn[1, 0]), f(translation[1])
    c0, c1, c2 = f(turn[2, 1] * py + turn[2, 2]), f(turn[2, 0]), f(translation[2])
    across, down, counts = out[0], out[1], out[2]
    wide, high, row, scale, most = f(share * lens[0]), f(share * lens[1]), f(py), f(1 << FRACTION), f(_MOST - 1)
    far = f(_FARTHEST)
    for x in range(inverse.size):
        c = c1 * px[x] + c0 + c2 * inverse[x]
        u = wide * (a1 * px[x] + a0 + a2 * inverse[x] - px[x] * c)
        v = high * (b1 * px[x] + b0 + b2 * inverse[x] - row * c)
        u, v = min(max(u, -far), far), min(max(v, -far), far)
        count = f(1) + min(np.ceil(max(abs(u), abs(v))), most)
        across[x], down[x] = np.int32(np.rint(u * scale / count)), np.int32(np.rint(v * scale / count))
        counts[x] = np.int32(count)


@njit(cache=True, nogil=True, inline="always")
def _place(x: Any, y: Any, width: int, height: int) -> Any:
    """Return the index of the pixel at fixed-point coordinates, clamped to the image."""
    return min(max(y >> FRACTION, 0), height - 1) * width + min(max(x >> FRACTION, 0), width - 1)


@njit(cache=True, nogil=True, inline="always")
def _fixed(value: Any) -> Any:
    return np.int64(np.rint(min(max(value, -_FARTHEST), _FARTHEST) * (1 << FRACTION)))


@inner
def _cells(inverse: Any, out: Any) -> None:
    """Compute the largest inverse depth in each cell and its eight neighbours."""
    height, width = inverse.shape
    largest, tallest = np.empty(out.shape, np.float32), np.empty(width, np.float32)
    for j in range(out.shape[0]):
        tallest[:] = np.float32(0)
        for y in range(j * _CELL, min((j + 1) * _CELL, height)):
            row = inverse[y]
            for x in range(width):
                tallest[x] = max(tallest[x], row[x])
        for i in range(out.shape[1]):
            largest[j, i] = _largest(tallest, i * _CELL, (i + 1) * _CELL)
    rows, columns = out.shape
    for j in range(rows):
        above, here, below = largest[max(j - 1, 0)], largest[j], largest[min(j + 1, rows - 1)]
        for i in range(columns):
            left, right = max(i - 1, 0), min(i + 1, columns - 1)
            first, last = (
                max(above[left], max(here[left], below[left])),
                max(above[right], max(here[right], below[right])),
            )
            out[j, i] = max(max(first, last), max(above[i], max(here[i], below[i])))


@inner
def _is_clear(cells: Any, limit: Any, x: Any, y: Any, dx: Any, dy: Any) -> Any:
    """Return whether no inverse depth within `_CELL` pixels of the path (dx, dy) centred on (x, y) exceeds `limit`."""
    rows, columns = cells.shape
    bits = FRACTION + _CELL_BITS
    count = (max(abs(dx), abs(dy)) >> (bits + 1)) + 1  # steps of less than two cells
    part = 1.0 / np.float64(count)
    sx, sy = np.int64(np.float64(dx) * part), np.int64(np.float64(dy) * part)
    x, y = x - (dx >> 1), y - (dy >> 1)
    for _ in range(count + 1):
        row, column = min(max(y >> bits, 0), rows - 1), min(max(x >> bits, 0), columns - 1)
        if cells[np.uint64(row), np.uint64(column)] > limit:
            return False
        x, y = x + sx, y + sy
    return True


@inner
def _path(x: Any, y: Any, dx: Any, dy: Any, count: Any, width: int, height: int, out: Any) -> None:
    """Write the indices of `count` pixels at steps of (dx, dy) on a path centred on (x, y), clamped to the image."""
    x, y = x - (((count - 1) * dx) >> 1), y - (((count - 1) * dy) >> 1)
    for k in range(count):
        out[k] = _place(x + k * dx, y + k * dy, width, height)


@inner
def _visible_sums(
    scene: Any, x: int, y: int, path: Any, near: Any, count: int, nearest: Any, places: Any, found: Any
) -> Any:
    """Return the sum and number of a pixel's views of nearer surfaces, then the same for views of its own surface."""
    packed, depths, width, height = scene
    own = depths[y * width + x]
    limit, solid, gain = own / _SAME, _SAME * nearest, 1.0 / np.float64(nearest - own)
    front, back, covered = np.uint64(0), np.uint64(0), np.uint64(0)
    fronts, backs, last = np.uint64(0), np.uint64(0), count - 1
    cx, cy = (np.int64(x) << FRACTION) + _HALF, (np.int64(y) << FRACTION) + _HALF
    _path(cx, cy, near[0], near[1], count, width, height, places)
    size = 0
    for k in range(count):  # without a branch, which would often be mispredicted
        found[np.uint64(size)] = k
        size += int(depths[places[k]] > limit)
    for i in range(size):
        view = np.int64(found[i])
        depth = depths[places[found[i]]]
        # a surface whose depth is between these two surfaces also has a displacement between theirs
        more = 1.0 if depth >= solid else np.float64(depth - own) * gain
        sx = path[0] + np.int64(np.float64(near[0] - path[0]) * more)
        sy = path[1] + np.int64(np.float64(near[1] - path[1]) * more)
        part = last - 2 * view  # in steps of half a view
        at = np.uint64(_place(cx - ((part * sx) >> 1), cy - ((part * sy) >> 1), width, height))
        seen = np.uint64(depths[at] > limit) & np.uint64(depths[at] >= _SAME * min(depth, solid))
        front += packed[at] * seen
        fronts += seen
        covered |= seen << np.uint64(view)
    _path(cx, cy, path[0], path[1], count, width, height, places)
    for k in range(count):
        at = places[k]
        seen = np.uint64(depths[at] <= limit) & ~(covered >> np.uint64(k))
        back += packed[at] * seen
        backs += seen
    if backs == 0:  # no view is known, so use the pixel's own colour
        return front, np.int64(fronts), packed[y * width + x], 1
    return front, np.int64(fronts), back, np.int64(backs)


@inner
def _blur_row(packed: Any, sums: Any, paths: Any, parts: Any, y: int, height: int, places: Any, out: Any) -> None:
    """Average each pixel of row `y` along its own path, ignoring nearer surfaces."""
    width = paths.shape[1]
    row = packed[y * width : (y + 1) * width]
    so_far = np.uint64(0)
    for x in range(width):
        sums[x] = so_far
        so_far += row[x]
    for x in range(width):
        dx, dy, count = np.int64(paths[0, x]), np.int64(paths[1, x]), np.int64(paths[2, x])
        left, top, total = np.int64(x) << FRACTION, np.int64(y) << FRACTION, np.uint64(0)
        length = abs(count * dx)
        if count <= _FEW:
            sx, sy = left - (((count - 1) * dx) >> 1), top - (((count - 1) * dy) >> 1)
            for _ in range(count):
                total += between(packed, width, height, sx, sy)
                sx, sy = sx + dx, sy + dy
            count *= EIGHTHS * EIGHTHS
        elif abs(count * dy) < 1 << FRACTION and length < _LONG:
            bits = _FINE if length < _SHORT else _COARSE
            start = (left + _HALF - (length >> 1)) >> (FRACTION - bits)
            end = (left + _HALF + (length >> 1)) >> (FRACTION - bits)
            total, count = until(sums, row, end, bits) - until(sums, row, start, bits), end - start
        else:
            _path(left + _HALF, top + _HALF, dx, dy, count, width, height, places)
            for k in range(count):
                total += packed[places[k]]
        divide(total, count, parts, out, 3 * (y * width + x))


@njit(cache=True, nogil=True, error_model="numpy")  # checks for division by zero would prevent vectorization
def _average(
    frame: Any, inverse: Any, near: Any, lens: Any, turn: Any, translation: Any, share: float, out: Any
) -> None:
    """Average the views of every pixel of a frame (H, W, 3) along its path, from inverse depths (H, W)."""
    height, width = inverse.shape
    packed, depths, bytes_ = np.empty(height * width, np.uint64), inverse.reshape(-1), out.reshape(-1)
    pack(frame, packed)
    scene = packed, depths, width, height
    sums = np.empty(width, np.uint64)
    cells = np.empty((-(-height // _CELL), -(-width // _CELL)), np.float32)
    if near.any():
        _cells(inverse, cells)
    parts = reciprocals()
    paths, rays = np.empty((3, width), np.int32), np.empty(width, np.float32)
    places, found = np.empty(_MOST, np.uint64), np.empty(_MOST, np.uint8)
    shares, turned = 1.0 / np.arange(_MOST + 1), (turn != 0).any()
    wide, high = share * lens[0], share * lens[1]
    for x in range(width):
        rays[x] = (x - lens[2]) / lens[0]
    for y in range(height):
        ray = (y - lens[3]) / lens[1]
        _row_of_paths(inverse[y], rays, ray, lens, turn, translation, share, paths)
        _blur_row(packed, sums, paths, parts, y, height, places, bytes_)
        for x in range(width):
            own, nearest = inverse[y, x], near[y // _TILE, x // _TILE]
            if own >= _SAME * nearest:
                continue
            dx, dy, count = np.int64(paths[0, x]), np.int64(paths[1, x]), np.int64(paths[2, x])
            cx, cy = (np.int64(x) << FRACTION) + _HALF, (np.int64(y) << FRACTION) + _HALF
            fx = count * dx + _fixed(np.float64(nearest - own) * wide * (translation[0] - rays[x] * translation[2]))
            fy = count * dy + _fixed(np.float64(nearest - own) * high * (translation[1] - ray * translation[2]))
            limit = own / _SAME
            # without rotation, the pixel's own path is part of the nearest surface's path
            if _is_clear(cells, limit, cx, cy, fx, fy) and (
                not turned or _is_clear(cells, limit, cx, cy, count * dx, count * dy)
            ):
                continue
            views = max(count, min(((max(abs(fx), abs(fy)) - 1) >> FRACTION) + 2, _MOST))
            dx, dy = dx * count // views, dy * count // views
            other = np.int64(np.float64(fx) * shares[views]), np.int64(np.float64(fy) * shares[views])
            front, fronts, back, backs = _visible_sums(scene, x, y, (dx, dy), other, views, nearest, places, found)
            mean(front, fronts, back, backs, views, out[y, x])

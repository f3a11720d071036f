"""Depth-dependent motion blur: the average of views of the frame along the camera path."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...compiled import njit
from ...images.contiguous import contiguous
from ...random.rng import Rng
from ...sample import Camera, DepthMap, Frame, SceneDepth
from ..base import DepthCorruption
from .camera_path import Motion, motion_of

_DRAWN = 0.03
"""For random camera motion: displacement of a point at the median depth, as a fraction of the image width.
"""
_EVERY = 16
"""Stride in pixels for estimating the median depth."""
_MOST = 40
"""Maximum number of views; on longer paths, the views are more than one pixel apart."""
_FEW, _EIGHTHS = 6, 8
"""Maximum number of views for which colours are interpolated between pixels, and the number of steps per pixel."""
_BITS = 16
_ROUND = 1 << (_BITS - 4)
_FARTHEST = 2.0**14
"""Fractional bits of fixed-point positions, rounding offset for 1/8 px, and maximum displacement in pixels."""
_NEAREST = np.float32(1e-6)
"""Smallest depth in metres; closer points are treated as if they were at this depth."""
_TILE = 16
"""Tile size in pixels; the nearest surface is stored per tile."""
_SAME = np.float32(0.9)
"""Two inverse depths belong to the same surface if their ratio (smaller to larger) is at least this value."""


class MotionBlurState(NamedTuple):
    """State for a pair: the camera path and the depth of the scene."""

    path: Motion
    """Camera motion between the frames: a point X in camera coordinates becomes `rotation @ X + translation`."""
    share: float
    """Exposure time as a fraction of the time between the frames."""
    camera: Camera
    depth: tuple[DepthMap, DepthMap]
    """Depth maps of both frames, in metres."""


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
    path is short). Where the uncovered background is not visible in the frame, the mean of the pixel's known views is
    used or, if there are none, the pixel's own colour. Outside the image, edge pixels are repeated.
    """

    name = "motion_blur_3d"
    family = "depth"
    paper_severities = (0.1, 0.25, 0.5, 0.75, 1.0)

    def draw_scene(self, rng: Rng, severity: int, depth: SceneDepth) -> MotionBlurState:
        """Return the state with the known camera path, or a random one."""
        path = motion_of(depth.camera) or _drawn(rng, depth)
        return MotionBlurState(path, float(self.parameter(severity)), depth.camera, depth.maps)

    def apply(self, frame: Frame, state: MotionBlurState, index: int) -> Frame:
        """Blur frame `index`, 0 or 1."""
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


def _drawn(rng: Rng, depth: SceneDepth) -> Motion:

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


@njit(cache=True, nogil=True)
def _pack(frame: Any, out: Any) -> None:
    """Pack three channels into one 64-bit integer, in which sums of up to 4096 values per channel do not overflow."""
    pixels = frame.reshape(-1)
    for i in range(out.size):
        red, green, blue = np.uint64(pixels[3 * i]), np.uint64(pixels[3 * i + 1]), np.uint64(pixels[3 * i + 2])
        out[i] = red | (green << np.uint64(20)) | (blue << np.uint64(40))


@njit(cache=True, nogil=True, inline="always")
def _step(lens: Any, turn: Any, translation: Any, x: Any, y: Any, inverse: Any) -> Any:
    """Return (u, v) in pixels: after a fraction t of the path, (x, y) shows the frame's content at (x - t u, y - t v).

    This is exact for a surface with this inverse depth if the camera does not rotate.
    """
    px, py = (x - lens[2]) / lens[0], (y - lens[3]) / lens[1]
    a = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] + translation[0] * inverse
    b = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] + translation[1] * inverse
    c = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] + translation[2] * inverse
    return lens[0] * (a - px * c), lens[1] * (b - py * c)


@njit(cache=True, nogil=True)
def _edge(inverse: Any, y0: int, x0: int) -> Any:
    """Return the largest inverse depth among a tile's edge pixels, i.e. pixels next to a farther surface."""
    height, width = inverse.shape
    largest = np.float32(0)
    for y in range(y0, min(y0 + _TILE, height)):
        above, row, below = inverse[max(y - 1, 0)], inverse[y], inverse[min(y + 1, height - 1)]
        for x in range(x0, min(x0 + _TILE, width)):
            sides = min(row[max(x - 1, 0)], row[min(x + 1, width - 1)])
            if min(min(above[x], below[x]), sides) < _SAME * row[x]:
                largest = max(largest, row[x])
    return largest


@njit(cache=True, nogil=True)
def _spread_near(inverse: Any, lens: Any, turn: Any, translation: Any, share: float, near: Any) -> None:
    """Compute, for each tile, the largest inverse depth of any edge that enters it during the exposure (0 if none)."""
    height, width = inverse.shape
    for j in range(near.shape[0]):
        for i in range(near.shape[1]):
            largest, across, down = _edge(inverse, j * _TILE, i * _TILE), 0.0, 0.0
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


@njit(cache=True, nogil=True)
def _row_of_paths(
    inverse: Any, px: Any, py: Any, lens: Any, turn: Any, translation: Any, share: float, out: Any
) -> None:
    """Compute, for each pixel in a row, the fixed-point (x, y) displacement per view and the number of views.

    `px` are the ray coordinates of the columns, and `py` is that of the row.
    """
    f = np.float32
    a0, a1, a2 = f(turn[0, 1] * py + turn[0, 2]), f(turn[0, 0]), f(translation[0])
    b0, b1, b2 = f(turn[1, 1] * py + turn[1, 2]), f(turn[1, 0]), f(translation[1])
    c0, c1, c2 = f(turn[2, 1] * py + turn[2, 2]), f(turn[2, 0]), f(translation[2])
    across, down, counts = out[0], out[1], out[2]
    wide, high, row, scale, most = f(share * lens[0]), f(share * lens[1]), f(py), f(1 << _BITS), f(_MOST - 1)
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
    return min(max(y >> _BITS, 0), height - 1) * width + min(max(x >> _BITS, 0), width - 1)


@njit(cache=True, nogil=True, inline="always")
def _fixed(value: Any) -> Any:
    """Convert a distance in pixels to fixed point."""
    return np.int64(np.rint(min(max(value, -_FARTHEST), _FARTHEST) * (1 << _BITS)))


@njit(cache=True, nogil=True)
def _shown(
    packed: Any, depths: Any, width: int, height: int, x: int, y: int, path: Any, near: Any, count: int, nearest: Any
) -> Any:
    """Return the sum and number of a pixel's views of a nearer surface, followed by those of its own surface.

    `path` and `near` are the fixed-point displacements per view of the pixel's own surface and of the nearest surface.
    """
    own = depths[y * width + x]
    limit = own / _SAME
    front, back = np.uint64(0), np.uint64(0)
    fronts = backs = 0
    half = np.int64(1 << (_BITS - 1))
    cx, cy = (np.int64(x) << _BITS) + half, (np.int64(y) << _BITS) + half
    for k in range(count):
        part = count - 1 - 2 * k  # in steps of half a view, from the last to the first
        at = _place(cx - ((part * near[0]) >> 1), cy - ((part * near[1]) >> 1), width, height)
        found = depths[at]
        if limit < found < _SAME * nearest:  # a surface between the two: follow its own path
            more = (found - own) / (nearest - own)
            sx = path[0] + np.int64(np.float64(near[0] - path[0]) * more)
            sy = path[1] + np.int64(np.float64(near[1] - path[1]) * more)
            at = _place(cx - ((part * sx) >> 1), cy - ((part * sy) >> 1), width, height)
            found = depths[at] if depths[at] >= _SAME * found else own
        if found > limit:
            front += packed[at]
            fronts += 1
            continue
        at = _place(cx - ((part * path[0]) >> 1), cy - ((part * path[1]) >> 1), width, height)
        if depths[at] <= limit:
            back += packed[at]
            backs += 1
    if backs == 0:  # use the pixel's own colour
        return front, fronts, packed[y * width + x], 1
    return front, fronts, back, backs


@njit(cache=True, nogil=True, inline="always")
def _mean(front: Any, fronts: Any, back: Any, backs: Any, count: Any, place: Any) -> Any:
    """Compute one channel of the mean; views whose background is unknown count as the mean of the known background."""
    mask = np.uint64((1 << 20) - 1)
    first, second = np.int64((front >> place) & mask), np.int64((back >> place) & mask)
    return np.uint8((first * backs + second * (count - fronts) + (count * backs) // 2) // (count * backs))


@njit(cache=True, nogil=True, inline="always")
def _between(packed: Any, width: int, height: int, x: Any, y: Any) -> Any:
    """Interpolate the colour between four pixels in steps of 1/8 px, and return it multiplied by 64."""
    x, y = (x + _ROUND) >> (_BITS - 3), (y + _ROUND) >> (_BITS - 3)
    right, down = np.uint64(1), np.uint64(width)
    if not (0 <= x < _EIGHTHS * (width - 1) and 0 <= y < _EIGHTHS * (height - 1)):
        x, y = min(max(x, 0), _EIGHTHS * (width - 1)), min(max(y, 0), _EIGHTHS * (height - 1))
        right = np.uint64(x < _EIGHTHS * (width - 1))
        down = np.uint64(width) * np.uint64(y < _EIGHTHS * (height - 1))
    wx, wy = np.uint64(x & 7), np.uint64(y & 7)
    at = np.uint64((y >> 3) * width + (x >> 3))
    upper = packed[at] * (np.uint64(8) - wx) + packed[at + right] * wx
    at += down
    lower = packed[at] * (np.uint64(8) - wx) + packed[at + right] * wx
    return upper * (np.uint64(8) - wy) + lower * wy


@njit(cache=True, nogil=True, inline="always")
def _divide(total: Any, count: Any, parts: Any, out: Any, at: Any) -> None:
    """Divide the three channels of a sum by `count`, with rounding; `parts` has reciprocals with 32 fractional bits."""
    mask, half, factor = np.uint64((1 << 20) - 1), np.uint64(count // 2), parts[count]
    out[at] = np.uint8((((total & mask) + half) * factor) >> np.uint64(32))
    out[at + 1] = np.uint8(((((total >> np.uint64(20)) & mask) + half) * factor) >> np.uint64(32))
    out[at + 2] = np.uint8((((total >> np.uint64(40)) + half) * factor) >> np.uint64(32))


@njit(cache=True, nogil=True)
def _average(
    frame: Any, inverse: Any, near: Any, lens: Any, turn: Any, translation: Any, share: float, out: Any
) -> None:
    height, width = inverse.shape
    packed, depths, bytes_ = np.empty(height * width, np.uint64), inverse.reshape(-1), out.reshape(-1)
    _pack(frame, packed)
    half = np.int64(1 << (_BITS - 1))
    parts = np.empty(_EIGHTHS * _EIGHTHS * _FEW + 1, np.uint64)  # division is exact for sums of up to this many bytes
    for k in range(1, parts.size):
        parts[k] = np.uint64((2**32 + k - 1) // k)
    paths, rays = np.empty((3, width), np.int32), np.empty(width, np.float32)
    for x in range(width):
        rays[x] = (x - lens[2]) / lens[0]
    for y in range(height):
        _row_of_paths(inverse[y], rays, (y - lens[3]) / lens[1], lens, turn, translation, share, paths)
        tiles = near[y // _TILE]
        for x in range(width):
            dx, dy, count = np.int64(paths[0, x]), np.int64(paths[1, x]), np.int64(paths[2, x])
            own, nearest = inverse[y, x], tiles[x // _TILE]
            if own < _SAME * nearest:
                u, v = _step(lens, turn, translation, float(x), float(y), float(nearest))
                u, v = u * share, v * share
                views = max(count, 1 + np.int64(min(np.ceil(max(abs(u), abs(v))), _MOST - 1.0)))
                dx, dy = dx * count // views, dy * count // views
                other = _fixed(u / views), _fixed(v / views)
                front, fronts, back, backs = _shown(
                    packed, depths, width, height, x, y, (dx, dy), other, views, nearest
                )
                for channel in range(3):
                    out[y, x, channel] = _mean(front, fronts, back, backs, views, np.uint64(20 * channel))
            elif count <= _FEW:
                sx = (np.int64(x) << _BITS) - (((count - 1) * dx) >> 1)
                sy = (np.int64(y) << _BITS) - (((count - 1) * dy) >> 1)
                total = np.uint64(0)
                for _ in range(count):
                    total += _between(packed, width, height, sx, sy)
                    sx, sy = sx + dx, sy + dy
                _divide(total, _EIGHTHS * _EIGHTHS * count, parts, bytes_, 3 * (y * width + x))
            else:
                sx = (np.int64(x) << _BITS) + half - (((count - 1) * dx) >> 1)
                sy = (np.int64(y) << _BITS) + half - (((count - 1) * dy) >> 1)
                ex, ey = sx + (count - 1) * dx, sy + (count - 1) * dy
                total = np.uint64(0)
                inside = min(sx, ex) >= 0 and max(sx, ex) >> _BITS < width
                if inside and min(sy, ey) >= 0 and max(sy, ey) >> _BITS < height:
                    for _ in range(count):
                        total += packed[np.uint64((sy >> _BITS) * width + (sx >> _BITS))]
                        sx, sy = sx + dx, sy + dy
                else:
                    for _ in range(count):
                        total += packed[_place(sx, sy, width, height)]
                        sx, sy = sx + dx, sy + dy
                _divide(total, count, parts, bytes_, 3 * (y * width + x))

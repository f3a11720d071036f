"""Blur with uniform disks whose radius depends on depth, layer by layer from the nearest to the farthest.

Each layer and its mask are blurred separately, using the running sums in disk.py. A layer that covers a fraction of a
pixel hides the same fraction of the layers behind it, and the visible colours are normalised by their coverage. So a
sharp foreground does not bleed into a blurred background, whereas a blurred foreground spreads over a sharp background.
Background that is hidden in the frame but visible through a blurred foreground is filled in by mirroring the pixels
next to the foreground (except for the edge pixel, where colours mix) as far inwards as the blur extends.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import njit
from ...images.contiguous import contiguous
from ...sample import Frame
from .borders import mirrored
from .disk_kernel import disk_parts

_ROWS, _COLUMNS = 32, 128
"""Number of pixels processed at a time, chosen so that their running sums fit in the L2 cache."""
_BLOCK = 16
"""Block size in pixels; the set of layers is stored per block."""
_U = np.uint64  # unsigned indices avoid numba's check for negative indices

Layers = npt.NDArray[np.uint8]
"""Layer index of each pixel, uint8 (H, W); 0 is the nearest of at most 32 layers."""


def blur_layers(frame: Frame, layers: Layers, radii: list[float]) -> Frame:
    """Blur each layer with a uniform disk and composite the layers from front to back; borders are mirrored.

    Args:
        frame: image to blur, RGB uint8 (H, W, 3).
        layers: layer index of each pixel, uint8 (H, W).
        radii: radius of each layer's disk, in pixels.

    >>> frame = np.zeros((9, 9, 3), np.uint8)
    >>> frame[4, 4] = 250
    >>> blur_layers(frame, np.zeros((9, 9), np.uint8), [1.0])[4, :, 0].tolist()
    [0, 0, 0, 50, 50, 50, 0, 0, 0]
    """
    frame = contiguous(frame)
    widths = np.zeros((len(radii), int(max(radii)) + 1), np.int64)
    areas = np.empty(len(radii), np.float32)
    for k, radius in enumerate(radii):
        half = disk_parts(radius, 0.0).widths
        widths[k, : len(half)] = half
        areas[k] = 2 * (2 * half + 1).sum() - (2 * half[0] + 1)
    reach = np.array([int(radius) for radius in radii], np.int64)
    source = np.full(layers.shape, -1, np.int32)
    if reach.any():
        distance = np.full(layers.shape, 255, np.uint8)
        _extend(layers, reach, distance.reshape(-1), source.reshape(-1))
    out = np.empty_like(frame)
    _blur(frame, layers, source, _present(layers, source, len(radii)), reach, widths, areas, out)
    return out


@njit(cache=True, nogil=True)
def _extend(layers: Any, reach: Any, distance: Any, source: Any) -> None:
    """Extend the background behind nearer pixels from four directions, up to the radius of their blur.

    For each pixel, `source` becomes the position in the frame that provides the colour and layer behind it, using the
    direction with the smallest `distance`.
    """
    height, width = layers.shape
    pixels = layers.reshape(-1)
    for y in range(height):
        for x in range(1, width):
            at = y * width + x
            if pixels[at] + 2 <= pixels[at - 1]:
                _walk(pixels, reach, at - 1, 1, x - 1, width - x, distance, source)
            elif pixels[at - 1] + 2 <= pixels[at]:
                _walk(pixels, reach, at, -1, width - 1 - x, x, distance, source)
    for at in range(width, height * width):
        y = at // width
        if pixels[at] + 2 <= pixels[at - width]:
            _walk(pixels, reach, at - width, width, y - 1, height - y, distance, source)
        elif pixels[at - width] + 2 <= pixels[at]:
            _walk(pixels, reach, at, -width, height - 1 - y, y, distance, source)


@njit(cache=True, nogil=True)
def _walk(pixels: Any, reach: Any, edge: int, step: int, behind: int, ahead: int, distance: Any, source: Any) -> None:
    """Fill the pixels after the last background pixel, which has `behind` pixels before it and `ahead` pixels after
    it."""
    depth = pixels[edge]
    for far in range(1, ahead + 1):
        at = edge + far * step
        if far > reach[pixels[at]] or pixels[at] + 2 > depth:
            return
        if far < distance[at]:
            distance[at] = far
            mirror = edge - min(far, behind) * step
            source[at] = mirror if abs(np.int64(pixels[mirror]) - np.int64(depth)) <= 1 else edge


@njit(cache=True, nogil=True)
def _collect(layers: Any, source: Any, present: Any) -> None:
    pixels, width = layers.reshape(-1), layers.shape[1]
    for y in range(layers.shape[0]):
        row = present[y // _BLOCK]
        for x in range(width):
            bits = np.uint32(1) << np.uint32(layers[y, x])
            if source[y, x] >= 0:
                bits |= np.uint32(1) << np.uint32(pixels[source[y, x]])
            row[x // _BLOCK] |= bits


def _present(layers: Layers, source: npt.NDArray[np.int32], count: int) -> npt.NDArray[np.uint32]:
    """Return bit masks of the layers that occur in or behind each block of pixels."""
    height, width = layers.shape
    present = np.zeros((-(-height // _BLOCK), -(-width // _BLOCK)), np.uint32)
    _collect(layers, source, present)
    return present


@njit(cache=True, nogil=True)
def _is_near(present: Any, layer: int, y0: int, y1: int, x0: int, x1: int, height: int, width: int) -> Any:
    """Return whether a layer may occur in rows y0 to y1 - 1 and columns x0 to x1 - 1."""
    bit = np.uint32(1) << np.uint32(layer)
    for v in range(max(y0, 0) // _BLOCK, (min(y1, height) - 1) // _BLOCK + 1):
        for u in range(max(x0, 0) // _BLOCK, (min(x1, width) - 1) // _BLOCK + 1):
            if present[v, u] & bit:
                return True
    return False


@njit(cache=True, nogil=True)
def _layer_sums(frame: Any, layers: Any, source: Any, layer: int, y: int, x0: int, sums: Any) -> None:
    """Compute the running sums of a layer's colours and mask in row `y`, starting at column `x0`: (4, n + 1)."""
    width = layers.shape[1]
    pixels, numbers = frame.reshape(-1), layers.reshape(-1)
    row = y * width
    places = source.reshape(-1)
    r = g = b = m = np.int32(0)
    sums[0, 0] = sums[1, 0] = sums[2, 0] = sums[3, 0] = 0
    for j in range(sums.shape[1] - 1):
        x = x0 + j
        at = row + (x if 0 <= x < width else mirrored(x, width))
        if numbers[at] == layer:
            r = np.int32(r + pixels[3 * at])
            g = np.int32(g + pixels[3 * at + 1])
            b = np.int32(b + pixels[3 * at + 2])
            m = np.int32(m + 1)
        elif places[at] >= 0:
            at = np.int64(places[at])
            if numbers[at] == layer:
                r = np.int32(r + pixels[3 * at])
                g = np.int32(g + pixels[3 * at + 1])
                b = np.int32(b + pixels[3 * at + 2])
                m = np.int32(m + 1)
        sums[0, j + 1], sums[1, j + 1], sums[2, j + 1], sums[3, j + 1] = r, g, b, m


@njit(cache=True, nogil=True)
def _add_segment(total: Any, row: Any, left: Any, right: Any) -> None:
    for i in range(_U(total.size)):
        total[i] = np.int32(total[i] + np.int32(row[right + i] - row[left + i]))


@njit(cache=True, nogil=True)
def _sum_row(sums: Any, y: int, reach: int, widths: Any, total: Any) -> None:
    """Sum over the disk around row `y`; the running sums start `reach` columns before the first column of `total`."""
    last = sums.shape[2] - 1
    for channel in range(4):
        line = total[channel]
        for i in range(line.size):
            line[i] = 0
        for dy in range(-reach, reach + 1):
            if sums[y + dy, 3, last] == 0:  # the layer does not occur in this row
                continue
            half = widths[abs(dy)]
            _add_segment(line, sums[y + dy, channel], _U(reach - half), _U(reach + half + 1))


@njit(cache=True, nogil=True)
def _put_behind(total: Any, area: Any, free: Any, colours: Any) -> Any:
    """Add a layer behind the previous ones; return whether any pixel is not yet fully covered."""
    covers, open_ = total[3], np.float32(0)
    for channel in range(3):
        line, colour = total[channel], colours[channel]
        for i in range(free.size):
            colour[i] += free[i] * (np.float32(line[i]) / area)
    for i in range(free.size):
        free[i] = free[i] * (np.float32(1) - np.float32(covers[i]) / area)
        open_ = max(open_, free[i])
    return open_ > 0


@njit(cache=True, nogil=True)
def _put_sharp_behind(
    frame: Any, layers: Any, source: Any, layer: int, y0: int, x0: int, free: Any, colours: Any
) -> Any:
    """Add a layer without blur behind the previous ones, like `_put_behind`."""
    width = layers.shape[1]
    pixels, numbers, places = frame.reshape(-1), layers.reshape(-1), source.reshape(-1)
    left = False
    for j in range(free.shape[0]):
        for i in range(free.shape[1]):
            share = free[j, i]
            if share == 0:
                continue
            at = (y0 + j) * width + x0 + i
            if numbers[at] != layer and places[at] >= 0:
                at = np.int64(places[at])
            if numbers[at] != layer:
                left = True
                continue
            for channel in range(3):
                colours[j, channel, i] += share * np.float32(pixels[3 * at + channel])
            free[j, i] = 0
    return left


@njit(cache=True, nogil=True)
def _blur(frame: Any, layers: Any, source: Any, present: Any, reach: Any, widths: Any, areas: Any, out: Any) -> None:
    height, width = layers.shape
    most = 0
    for k in range(reach.size):
        most = max(most, reach[k])
    room = np.empty((_ROWS + 2 * most) * 4 * (_COLUMNS + 2 * most + 1), np.int32)
    for y0 in range(0, height, _ROWS):
        rows = min(_ROWS, height - y0)
        for x0 in range(0, width, _COLUMNS):
            columns = min(_COLUMNS, width - x0)
            free = np.ones((rows, columns), np.float32)
            colours = np.zeros((rows, 3, columns), np.float32)
            total = np.empty((4, columns), np.int32)
            for k in range(reach.size):
                r = reach[k]
                if not _is_near(present, k, y0 - r, y0 + rows + r, x0 - r, x0 + columns + r, height, width):
                    continue
                if r == 0:
                    if not _put_sharp_behind(frame, layers, source, k, y0, x0, free, colours):
                        break
                    continue
                n = columns + 2 * r + 1
                sums = room[: (rows + 2 * r) * 4 * n].reshape(rows + 2 * r, 4, n)
                for j in range(rows + 2 * r):
                    y = mirrored(y0 - r + j, height)
                    if _is_near(present, k, y, y + 1, x0 - r, x0 + columns + r, height, width):
                        _layer_sums(frame, layers, source, k, y, x0 - r, sums[j])
                    else:
                        sums[j, 3, n - 1] = 0  # tells `_sum_row` that the row is empty
                left = False
                for j in range(rows):
                    _sum_row(sums, j + r, r, widths[k], total)
                    left = _put_behind(total, areas[k], free[j], colours[j]) or left
                if not left:
                    break
            for j in range(rows):
                for i in range(columns):
                    share = np.float32(1) - free[j, i]
                    for channel in range(3):
                        level = colours[j, channel, i] / share
                        out[y0 + j, x0 + i, channel] = np.uint8(np.rint(min(level, np.float32(255))))

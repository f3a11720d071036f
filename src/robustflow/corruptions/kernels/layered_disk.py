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

from ...core.compiled import contiguous, inner, njit
from ...core.types import Frame
from .disk import disk_parts
from .filters import mirrored

_ROWS, _COLUMNS = 32, 128
"""Number of pixels processed at a time, chosen so that their running sums fit in the L2 cache."""
_BLOCK = 16
"""Block size in pixels; the set of layers is stored per block."""
_NONE = np.uint8(255)
"""Layer index that indicates that there is no background."""
_FIELD, _MOST = 18, 1023
"""Bits per colour in a packed 64-bit value, whose highest bits count pixels, and maximum number of pixels in a sum."""
_U = np.uint64  # unsigned indices avoid numba's check for negative indices

Layers = npt.NDArray[np.uint8]
"""Layer index of each pixel, uint8 (H, W); 0 is the nearest of at most 32 layers."""


def blur_layers(frame: Frame, layers: Layers, radii: list[float]) -> Frame:
    """Blur each layer with a uniform disk and composite the layers from front to back; borders are mirrored.

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
    behind = np.empty(layers.shape, np.uint8)
    packed, packed_behind = np.empty((2, *layers.shape), np.uint64)
    present = np.zeros((-(-layers.shape[0] // _BLOCK), -(-layers.shape[1] // _BLOCK)), np.uint32)
    _pack(frame, layers, source, packed, packed_behind, behind, present)
    out = np.empty_like(frame)
    _blur(packed, layers, packed_behind, behind, present, reach, widths, areas, out)
    return out


@njit(cache=True, nogil=True)
def _extend(layers: Any, reach: Any, distance: Any, source: Any) -> None:
    """Extend the background behind nearer pixels from four directions, up to the radius of their blur."""
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


@inner
def _walk(pixels: Any, reach: Any, edge: int, step: int, behind: int, ahead: int, distance: Any, source: Any) -> None:
    """Fill the pixels after the last background pixel, which has `behind` pixels before it and `ahead` pixels after
    it.
    """
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
def _pack(frame: Any, layers: Any, source: Any, packed: Any, packed_behind: Any, behind: Any, present: Any) -> None:
    """Pack the colour and coverage of each pixel, and those of the background behind it, into 64-bit values."""
    height, width = layers.shape
    for y in range(height):
        pixels, words = frame[y], packed[y]
        for x in range(width):
            colour = _U(pixels[x, 0]) | (_U(pixels[x, 1]) << _U(_FIELD)) | (_U(pixels[x, 2]) << _U(2 * _FIELD))
            words[x] = colour | (_U(1) << _U(3 * _FIELD))
    flat, numbers = packed.reshape(-1), layers.reshape(-1)
    for y in range(height):
        row, places, words, own, other = present[y // _BLOCK], source[y], packed_behind[y], layers[y], behind[y]
        for x in range(width):
            place = places[x]
            bits = np.uint32(1) << np.uint32(own[x])
            other[x] = _NONE
            if place >= 0:
                words[x], other[x] = flat[place], numbers[place]
                bits |= np.uint32(1) << np.uint32(other[x])
            row[x // _BLOCK] |= bits


@inner
def _is_near(present: Any, layer: int, y0: int, y1: int, x0: int, x1: int, height: int, width: int) -> Any:
    """Return whether a layer may occur in rows y0 to y1 - 1 and columns x0 to x1 - 1."""
    bit = np.uint32(1) << np.uint32(layer)
    for v in range(max(y0, 0) // _BLOCK, (min(y1, height) - 1) // _BLOCK + 1):
        for u in range(max(x0, 0) // _BLOCK, (min(x1, width) - 1) // _BLOCK + 1):
            if present[v, u] & bit:
                return True
    return False


@inner
def _layer_sums(words: Any, own: Any, words_behind: Any, behind: Any, layer: Any, x0: int, sums: Any) -> None:
    """Compute the running sums of a layer's packed values in a row, starting at column `x0`: (n + 1,)."""
    width, n = own.size, sums.size - 1
    first, last = max(-x0, 0), min(width - x0, n)
    for j in range(_U(first), _U(last)):
        x = _U(x0) + j
        in_front = _U(own[x] == layer)
        sums[j + _U(1)] = words[x] * in_front + words_behind[x] * (_U(behind[x] == layer) & ~in_front)
    for part in (range(first), range(last, n)):
        for j in part:
            x = mirrored(x0 + j, width)
            sums[j + 1] = words[x] if own[x] == layer else words_behind[x] if behind[x] == layer else _U(0)
    total = sums[0] = _U(0)
    for j in range(n):
        total += sums[j + 1]
        sums[j + 1] = total


@inner
def _add_segment(total: Any, row: Any, left: Any, right: Any) -> None:
    for i in range(_U(total.size)):
        total[i] += row[right + i] - row[left + i]


@inner
def _sum_row(sums: Any, y: int, reach: int, widths: Any, word: Any, total: Any) -> None:
    """Sum over the disk around row `y`; the running sums start `reach` columns before the first column of `total`."""
    last = sums.shape[1] - 1
    total[:] = np.int32(0)
    word[:] = _U(0)
    area = 0
    for dy in range(-reach, reach + 1):
        half = widths[abs(dy)]
        area += 2 * half + 1
        if area > _MOST:
            _unpack(word, total)
            area = 2 * half + 1
        if sums[y + dy, last] != 0:  # the layer occurs in this row
            _add_segment(word, sums[y + dy], _U(reach - half), _U(reach + half + 1))
    _unpack(word, total)


@inner
def _unpack(word: Any, total: Any) -> None:
    """Add packed sums (N,) to `total` (4, N), red, green, blue and coverage, before a field can overflow."""
    mask = _U((1 << _FIELD) - 1)
    red, green, blue, cover = total[0], total[1], total[2], total[3]
    for i in range(word.size):
        red[i] += np.int32(word[i] & mask)
        green[i] += np.int32((word[i] >> _U(_FIELD)) & mask)
        blue[i] += np.int32((word[i] >> _U(2 * _FIELD)) & mask)
        cover[i] += np.int32(word[i] >> _U(3 * _FIELD))
        word[i] = _U(0)


@inner
def _add_behind(total: Any, area: Any, free: Any, colours: Any) -> Any:
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


@inner
def _add_sharp_behind(
    packed: Any, layers: Any, packed_behind: Any, behind: Any, layer: int, y0: int, x0: int, free: Any, colours: Any
) -> Any:
    """Add an unblurred layer behind the previous ones, like `_add_behind`."""
    mask, left = _U((1 << _FIELD) - 1), False
    for j in range(free.shape[0]):
        for i in range(free.shape[1]):
            share = free[j, i]
            if share == 0:
                continue
            y, x = y0 + j, x0 + i
            if layers[y, x] == layer:
                word = packed[y, x]
            elif behind[y, x] == layer:
                word = packed_behind[y, x]
            else:
                left = True
                continue
            for channel in range(3):
                colours[j, channel, i] += share * np.float32((word >> _U(channel * _FIELD)) & mask)
            free[j, i] = 0
    return left


@njit(cache=True, nogil=True)
def _write(free: Any, colours: Any, levels: Any, out: Any) -> None:
    """Divide the colours in a row by their coverage and round them."""
    for channel in range(3):
        colour, level = colours[channel], levels[channel]
        for i in range(free.size):
            level[i] = np.uint8(np.int32(np.rint(min(colour[i] / (np.float32(1) - free[i]), np.float32(255)))))
    for i in range(free.size):
        out[i, 0], out[i, 1], out[i, 2] = levels[0, i], levels[1, i], levels[2, i]


@njit(cache=True, nogil=True)
def _blur(
    packed: Any,
    layers: Any,
    packed_behind: Any,
    behind: Any,
    present: Any,
    reach: Any,
    widths: Any,
    areas: Any,
    out: Any,
) -> None:
    """Blur in strips of rows and columns that fit the cache, from the nearest layer (H, W) to the farthest."""
    height, width = layers.shape
    most = 0
    for k in range(reach.size):
        most = max(most, reach[k])
    room = np.empty((_ROWS + 2 * most) * (_COLUMNS + 2 * most + 1), np.uint64)
    levels = np.empty((3, _COLUMNS), np.uint8)
    for y0 in range(0, height, _ROWS):
        rows = min(_ROWS, height - y0)
        for x0 in range(0, width, _COLUMNS):
            columns = min(_COLUMNS, width - x0)
            free = np.ones((rows, columns), np.float32)
            colours = np.zeros((rows, 3, columns), np.float32)
            word, total = np.empty(columns, np.uint64), np.empty((4, columns), np.int32)
            for k in range(reach.size):
                r = reach[k]
                if not _is_near(present, k, y0 - r, y0 + rows + r, x0 - r, x0 + columns + r, height, width):
                    continue
                if r == 0:
                    if not _add_sharp_behind(packed, layers, packed_behind, behind, k, y0, x0, free, colours):
                        break
                    continue
                n = columns + 2 * r + 1
                sums = room[: (rows + 2 * r) * n].reshape(rows + 2 * r, n)
                for j in range(rows + 2 * r):
                    y = mirrored(y0 - r + j, height)
                    if _is_near(present, k, y, y + 1, x0 - r, x0 + columns + r, height, width):
                        _layer_sums(packed[y], layers[y], packed_behind[y], behind[y], k, x0 - r, sums[j])
                    else:
                        sums[j, n - 1] = 0  # tells `_sum_row` that the row is empty
                left = False
                for j in range(rows):
                    _sum_row(sums, j + r, r, widths[k], word, total)
                    left = _add_behind(total, areas[k], free[j], colours[j]) or left
                if not left:
                    break
            for j in range(rows):
                _write(free[j], colours[j], levels[:, :columns], out[y0 + j, x0 : x0 + columns])

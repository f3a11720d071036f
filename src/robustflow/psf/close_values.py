"""The compiled loops of `rounded_blur` over values: to round them, and to compute some again that are close."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compile_late import njit_late


@njit_late(
    "int64(float32[:,:,::1], int64, float64, float64, uint8[:,:,::1], int32[:,::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def round_all(total: Any, left: Any, grey: Any, margin: Any, rounded: Any, close: Any) -> Any:
    """Round to bytes; note what lies closer than `margin` to the middle between two.

    Args:
        total: (3, at least left + W, H), grey levels less `grey`.
        left: the first column that counts.
        margin: grey levels.
        rounded: (H, W, 3) receives the bytes.
        close: (n, 3) receives y, x and channel of the first n values that are close.

    Returns:
        How many are close.
    """
    count = 0
    for x in range(rounded.shape[1]):
        for channel in range(3):
            column = total[channel, left + x]
            for y in range(rounded.shape[0]):
                value = column[y] + grey
                nearest = np.floor(value + 0.5)
                rounded[y, x, channel] = np.uint8(min(max(nearest, 0.0), 255.0))
                if 0.5 - abs(value - nearest) < margin:
                    if count < close.shape[0]:
                        close[count, 0], close[count, 1], close[count, 2] = y, x, channel
                    count += 1
    return count


@njit_late(
    "void(int32[:,::1], float32[:,:,::1], int64, int64, float32[:,:,:,:,::1],"
    " int64[:,::1], float64[:,::1], int64[:,::1], float64[:,::1], float64[::1])",
    cache=True,
    fastmath=True,
    nogil=True,
    error_model="numpy",
)
def plain_sums(
    places: Any,
    pixels: Any,
    left: Any,
    top: Any,
    kernels: Any,
    nodes_x: Any,
    weights_x: Any,
    nodes_y: Any,
    weights_y: Any,
    out: Any,
) -> None:
    """Values of the blur as sums over kernels.

    Args:
        places: (n, 3), y, x and channel.
        pixels: (3, X, Y), an image continued on all sides.
        left, top: the column and the row of it at which the kernel of the first pixel begins.
        kernels: (columns of nodes, rows of nodes, 3, A, B), along x and y, last lag first.
        nodes_x, weights_x: (W, 2), which nodes have a weight at a column, less than zero (`~node`) if mirrored.
        nodes_y, weights_y: (H, 2), the same of rows.
        out: (n,) receives the values.
    """
    wide, high = kernels.shape[3], kernels.shape[4]
    for number in range(places.shape[0]):
        y, x, channel = places[number]
        total = 0.0
        for i in range(2):
            for j in range(2):
                node_x, node_y = nodes_x[x, i], nodes_y[y, j]
                kernel = kernels[node_x if node_x >= 0 else ~node_x, node_y if node_y >= 0 else ~node_y, channel]
                part = 0.0
                for a in range(wide):
                    column = pixels[channel, left + x + (a if node_x >= 0 else wide - 1 - a), top + y : top + y + high]
                    line = kernel[a]
                    if node_y >= 0:
                        for b in range(high):
                            part += np.float64(line[b]) * column[b]
                    else:
                        for b in range(high):
                            part += np.float64(line[b]) * column[high - 1 - b]
                total += weights_x[x, i] * weights_y[y, j] * part
        out[number] = total


@njit_late("float64(int16[:,::1], uint8[:,::1], float64, int64, int64[::1], int64, int64[::1])", cache=True)
def dot(kernel: Any, plane: Any, grey: Any, lag_y: Any, inputs_y: Any, lag_x: Any, inputs_x: Any) -> Any:
    """The sum of pixels of (H, W), less `grey`, times the elements of a kernel (N, N) that belong to them.

    The first of `inputs` (N,), indices into the plane, belongs to the element `lag`, the second to the one before it,
    around the circle.
    """
    size, total = inputs_x.size, 0.0
    for i in range(inputs_y.size):
        line, pixels = kernel[(lag_y - i) % size], plane[inputs_y[i]]
        for j in range(lag_x + 1):
            total += line[lag_x - j] * (pixels[inputs_x[j]] - grey)
        for j in range(lag_x + 1, size):
            total += line[size + lag_x - j] * (pixels[inputs_x[j]] - grey)
    return total

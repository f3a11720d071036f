"""Convert between RGB and YUV 4:2:0 in exact integer arithmetic, independent of the version of any scaling library.

The colour space is 8-bit BT.601 with limited range, which FFmpeg assumes when it converts PNG files to H.264 and back;
this is how the published GoPro-FC was created. As in FFmpeg's unscaled converter, chroma is averaged over 2x2 pixels
when encoding and repeated when decoding. Frames are stored as I420: uint8 (H * 3 / 2, W) with the Y plane, followed by
U and V.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..compiled import njit
from ..sample import Frame

I420 = npt.NDArray[np.uint8]
"""A YUV 4:2:0 frame, uint8 (H * 3 / 2, W); H and W are even."""


def even_size(height: int, width: int) -> tuple[int, int]:
    """Round both sides up to even numbers, as required by 4:2:0."""
    return height + height % 2, width + width % 2


def rgb_to_i420(frame: Frame) -> I420:
    """Convert RGB uint8 (H, W, 3) to I420 uint8; odd sizes are padded by repeating the last row or column."""
    height, width = frame.shape[:2]
    rows, columns = even_size(height, width)
    if (rows, columns) != (height, width):
        frame = np.pad(frame, ((0, rows - height), (0, columns - width), (0, 0)), mode="edge")
    out = np.empty((rows * 3 // 2, columns), np.uint8)
    chroma = out[rows:].reshape(2, rows // 2, columns // 2)
    _to_yuv(np.ascontiguousarray(frame), out[:rows], chroma[0], chroma[1])
    return out


def i420_to_rgb(picture: I420, height: int, width: int) -> Frame:
    """Convert I420 to RGB uint8 (height, width, 3), cropping off the padding of odd sizes."""
    rows, columns = even_size(height, width)
    if picture.shape != (rows * 3 // 2, columns):
        raise ValueError(f"I420 for {height}x{width} has the shape {(rows * 3 // 2, columns)}, not {picture.shape}")
    picture = np.ascontiguousarray(picture)
    chroma = picture[rows:].reshape(2, rows // 2, columns // 2)
    out = np.empty((height, width, 3), np.uint8)
    _to_rgb(picture[:rows], chroma[0], chroma[1], out)
    return out


@njit(cache=True, nogil=True)
def _to_yuv(rgb: Any, luma: Any, blue: Any, red: Any) -> None:
    # coefficients times 2**16; chroma is computed from the sum of four pixels, hence 2**18
    for i in range(blue.shape[0]):
        for j in range(blue.shape[1]):
            r_sum = 0
            g_sum = 0
            b_sum = 0
            for di in range(2):
                for dj in range(2):
                    pixel = rgb[2 * i + di, 2 * j + dj]
                    r, g, b = int(pixel[0]), int(pixel[1]), int(pixel[2])
                    luma[2 * i + di, 2 * j + dj] = 16 + ((16829 * r + 33039 * g + 6416 * b + 32768) >> 16)
                    r_sum += r
                    g_sum += g
                    b_sum += b
            blue[i, j] = 128 + ((-9714 * r_sum - 19071 * g_sum + 28785 * b_sum + 131072) >> 18)
            red[i, j] = 128 + ((28785 * r_sum - 24104 * g_sum - 4681 * b_sum + 131072) >> 18)


@njit(cache=True, nogil=True)
def _to_rgb(luma: Any, blue: Any, red: Any, rgb: Any) -> None:
    for i in range(rgb.shape[0]):
        for j in range(rgb.shape[1]):
            y = 76309 * (int(luma[i, j]) - 16) + 32768
            u = int(blue[i >> 1, j >> 1]) - 128
            v = int(red[i >> 1, j >> 1]) - 128
            rgb[i, j, 0] = min(max((y + 104597 * v) >> 16, 0), 255)
            rgb[i, j, 1] = min(max((y - 25675 * u - 53279 * v) >> 16, 0), 255)
            rgb[i, j, 2] = min(max((y + 132201 * u) >> 16, 0), 255)

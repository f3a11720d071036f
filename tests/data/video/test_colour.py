"""Compare RGB <-> I420 conversion with the standard's definition in floating point and with FFmpeg's converter."""

from __future__ import annotations

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robustflow.data.video.codec import i420_to_rgb, rgb_to_i420

from .clips import frames

RGB = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(lambda size: arrays(np.uint8, (*size, 3)))


def reference_yuv(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert to BT.601 limited range as defined, in float64, averaging chroma over 2x2 pixels; sizes must be even."""
    r, g, b = (rgb[..., c] / 255.0 for c in range(3))
    y = 0.299 * r + 0.587 * g + 0.114 * b
    cb, cr = 0.5 * (b - y) / (1 - 0.114), 0.5 * (r - y) / (1 - 0.299)
    halved = [c.reshape(c.shape[0] // 2, 2, c.shape[1] // 2, 2).mean((1, 3)) for c in (cb, cr)]
    return 16 + 219 * y, 128 + 224 * halved[0], 128 + 224 * halved[1]


def reference_rgb(y: np.ndarray, cb: np.ndarray, cr: np.ndarray) -> np.ndarray:
    """Compute the inverse as defined, repeating chroma."""
    y = (y.astype(float) - 16) / 219
    cb, cr = ((c.astype(float).repeat(2, 0).repeat(2, 1) - 128) / 224 for c in (cb, cr))
    r, b = y + 2 * (1 - 0.299) * cr, y + 2 * (1 - 0.114) * cb
    g = (y - 0.299 * r - 0.114 * b) / 0.587
    return np.clip(np.stack([r, g, b], -1) * 255, 0, 255)


@given(RGB)
def test_conversion_equals_the_standard(rgb):
    height, width = rgb.shape[:2]
    even = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    picture = rgb_to_i420(rgb)
    rows, columns = even.shape[:2]
    chroma = picture[rows:].reshape(2, rows // 2, columns // 2)
    y, cb, cr = reference_yuv(even)
    for mine, exact in ((picture[:rows], y), (chroma[0], cb), (chroma[1], cr)):
        assert np.abs(mine - exact).max() <= 0.5 + 0.01  # for rounding and 16-bit coefficients
    back = i420_to_rgb(picture, height, width)
    exact = reference_rgb(picture[:rows], chroma[0], chroma[1])[:height, :width]
    assert np.abs(back - exact).max() <= 0.5 + 0.02


def test_conversion_is_within_rounding_of_ffmpeg():
    frame = frames(1, 96, 128)[0]
    by_ffmpeg = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format="yuv420p").to_ndarray()
    mine = rgb_to_i420(frame)
    assert np.abs(mine[:96].astype(int) - by_ffmpeg[:96]).max() <= 1
    picture = av.VideoFrame.from_ndarray(mine, format="yuv420p")
    back = picture.to_ndarray(format="rgb24").astype(int)
    assert np.abs(i420_to_rgb(mine, 96, 128) - back).max() <= 3


def test_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="I420"):
        i420_to_rgb(np.zeros((9, 8), np.uint8), 8, 8)

"""Increase the frame rate of a clip with an interpolator, as a stream, so that the clip can have any length.

The interpolator "flow" uses bidirectional DIS flow and takes occlusions into account; it does not require FLAVR's
weights. The algorithm follows the Middlebury benchmark (Baker et al., IJCV 2011, Sec. 3.3 "Interpolation error"): warp
the flow forward to the new time, keep the most consistent vector where several land on the same pixel, fill holes, and
blend both frames except where the point is occluded in one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...core.compiled import inner, njit
from ...core.errors import AssetError, UsageError
from ...core.types import Frame
from ...models.dis.dis_rgb import OperatingPoint, dis_flow

WINDOW = 4
"""Number of frames passed to an interpolator: the two frames around the gap and one more on each side, as required by
FLAVR.
"""


class Interpolator(Protocol):
    name: str

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        """Return the `factor - 1` evenly spaced frames between `window[1]` and `window[2]`."""

    def describe(self) -> dict[str, Any]:
        """Return everything that affects the output (method, checkpoint hash, versions), for the manifest."""


def load_interpolator(
    name: str | None, factor: int, checkpoint: Path | None, device: str = "cpu"
) -> Interpolator | None:
    if factor == 1:
        return None
    if name == "flow":
        return FlowInterpolator()
    if name == "flavr":
        if checkpoint is None:
            raise AssetError("--checkpoint", "FLAVR needs its official 4x weights; or use --interpolator flow")
        from .flavr import FlavrInterpolator

        return FlavrInterpolator(checkpoint, device)
    choices = "flavr (as in the paper, requires --checkpoint) or flow (bidirectional DIS flow, requires no weights)"
    raise UsageError("--interpolator", f"a factor of {factor} needs one, not {name or 'none'}; choose {choices}")


def interpolated_count(count: int, factor: int) -> int:
    return count if factor == 1 else max(0, (count - WINDOW + 1) * factor + 1)


def interpolate(frames: Iterable[Frame], interpolator: Interpolator, factor: int) -> Iterator[Frame]:
    """Yield all frames except the first and the last, with `factor - 1` new frames in every gap."""
    return fill_gaps(windows(frames), interpolator, factor)


def windows(frames: Iterable[Frame]) -> Iterator[tuple[Frame, ...]]:
    """Yield the four frames around every gap that has two frames on either side."""
    window: tuple[Frame, ...] = ()
    for frame in frames:
        window = (*window[-WINDOW + 1 :], frame)
        if len(window) == WINDOW:
            yield window


def fill_gaps(
    around: Iterable[tuple[Frame, ...]], interpolator: Interpolator, factor: int, first: bool = True
) -> Iterator[Frame]:
    """Yield, for each window, the new frames and the frame that follows; with `first`, also the frame before them."""
    for window in around:
        if first:
            yield window[1]
            first = False
        yield from interpolator.between(window, factor)
        yield window[2]


_POINT = OperatingPoint(finest_scale=1, patch_size=8, overlap=0.5, iterations=12, refined=True)
"""Chosen by the PSNR of interpolated frames of real videos; point 3 takes six times as long and is not better."""

CONSISTENT = 1.0
"""A point is visible in both frames if forward and backward flow cancel to within this many pixels, plus a tenth of the
flow magnitude.
"""


class FlowInterpolator:
    """The interpolator "flow"; its frames are the same on every processor."""

    name = "flow"

    def between(self, window: Sequence[Frame], factor: int) -> list[Frame]:
        first, second = (np.ascontiguousarray(frame) for frame in window[1:3])
        forward, backward = dis_flow(first, second, _POINT), dis_flow(second, first, _POINT)
        seen_first, seen_second = _visible(forward, backward), _visible(backward, forward)
        out = []
        for step in range(1, factor):
            time = step / factor
            flow, sight = _carry(forward, backward, seen_first, seen_second, first, second, np.float32(time))
            out.append(_blend(first, second, flow, sight, np.float32(time)))
        return out

    def describe(self) -> dict[str, Any]:
        return {"name": self.name, "method": "bidirectional DIS on colours, occlusion-aware", **asdict(_POINT)}


@njit(cache=True, nogil=True)
def _visible(flow: Any, back: Any) -> Any:
    """Return, as bool (H, W), whether each point remains inside the frame and is not occluded in the other frame."""
    height, width = flow.shape[:2]
    out = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            u, v = flow[y, x, 0], flow[y, x, 1]
            tx, ty = int(np.floor(x + u + 0.5)), int(np.floor(y + v + 0.5))
            if 0 <= tx < width and 0 <= ty < height:
                gap = _length(u + back[ty, tx, 0], v + back[ty, tx, 1])
                out[y, x] = gap <= CONSISTENT + 0.1 * _length(u, v)
    return out


@njit(cache=True, nogil=True)
def _length(u: Any, v: Any) -> Any:
    return np.sqrt(u * u + v * v)  # the last bit of np.hypot depends on the C library


@njit(cache=True, nogil=True)
def _carry(forward: Any, backward: Any, seen_first: Any, seen_second: Any, first: Any, second: Any, time: Any) -> Any:
    """Return the flow from frame 1 to frame 2 at `time`, float32 (H, W, 2), and the visibility of each point."""
    height, width = forward.shape[:2]
    flow = np.zeros((height, width, 2), np.float32)
    sight = np.zeros((height, width), np.uint8)
    cost = np.full((height, width), np.float32(1e9))
    for side in range(2):
        source = forward if side == 0 else backward
        seen = seen_first if side == 0 else seen_second
        span = time if side == 0 else np.float32(1) - time
        sign = np.float32(1) if side == 0 else np.float32(-1)
        for y in range(height):
            for x in range(width):
                u, v = source[y, x, 0], source[y, x, 1]
                px, py = x + span * u, y + span * v
                x0, y0 = int(np.floor(px)), int(np.floor(py))
                if x0 < -1 or y0 < -1 or x0 >= width or y0 >= height:
                    continue
                if seen[y, x]:
                    tx = min(max(int(np.floor(x + u + 0.5)), 0), width - 1)
                    ty = min(max(int(np.floor(y + v + 0.5)), 0), height - 1)
                    here = first[y, x] if side == 0 else second[y, x]
                    there = second[ty, tx] if side == 0 else first[ty, tx]
                    claim = np.float32(0)
                    for c in range(3):
                        claim += abs(np.float32(here[c]) - np.float32(there[c]))
                    mark = 0
                else:
                    claim = np.float32(1e6) + span * _length(u, v)  # only if no visible point moves to the pixel
                    mark = 1 + side
                for dy in range(2):
                    for dx in range(2):
                        tx, ty = x0 + dx, y0 + dy
                        if 0 <= tx < width and 0 <= ty < height and claim < cost[ty, tx]:
                            cost[ty, tx] = claim
                            flow[ty, tx, 0], flow[ty, tx, 1] = sign * u, sign * v
                            sight[ty, tx] = mark
    _fill_holes(flow, cost)
    return flow, sight


@inner
def _fill_holes(flow: Any, cost: Any) -> None:
    """Fill holes with the flow at the nearest filled point in the same row, or otherwise in the same column."""
    height, width = cost.shape
    empty = np.float32(1e9)
    for axis in range(2):
        lines, length = (height, width) if axis == 0 else (width, height)
        for line in range(lines):
            for position in range(length):
                y, x = (line, position) if axis == 0 else (position, line)
                if cost[y, x] < empty:
                    continue
                for distance in range(1, length):
                    before, after = position - distance, position + distance
                    ys, xs = (line, before) if axis == 0 else (before, line)
                    if before >= 0 and cost[ys, xs] < np.float32(2e6):
                        flow[y, x] = flow[ys, xs]
                        cost[y, x] = np.float32(5e6)
                        break
                    ys, xs = (line, after) if axis == 0 else (after, line)
                    if after < length and cost[ys, xs] < np.float32(2e6):
                        flow[y, x] = flow[ys, xs]
                        cost[y, x] = np.float32(5e6)
                        break


@njit(cache=True, nogil=True)
def _blend(first: Any, second: Any, flow: Any, sight: Any, time: Any) -> Any:
    """Sample both frames along the flow and blend them by time."""
    height, width = flow.shape[:2]
    out = np.empty((height, width, 3), np.uint8)
    for y in range(height):
        for x in range(width):
            u, v = flow[y, x, 0], flow[y, x, 1]
            weight = time
            if sight[y, x] == 1:
                weight = np.float32(0)
            elif sight[y, x] == 2:
                weight = np.float32(1)
            for c in range(3):
                a = _sample(first, x - time * u, y - time * v, c)
                b = _sample(second, x + (1 - time) * u, y + (1 - time) * v, c)
                out[y, x, c] = int(min(max(a + weight * (b - a) + 0.5, 0), 255))
    return out


@njit(cache=True, nogil=True, inline="always")
def _sample(image: Any, x: Any, y: Any, channel: int) -> Any:
    height, width = image.shape[:2]
    x = min(max(x, 0.0), width - 1.0)
    y = min(max(y, 0.0), height - 1.0)
    x0, y0 = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
    fx, fy = x - x0, y - y0
    top = image[y0, x0, channel] * (1 - fx) + image[y0, x1, channel] * fx
    low = image[y1, x0, channel] * (1 - fx) + image[y1, x1, channel] * fx
    return top * (1 - fy) + low * fy

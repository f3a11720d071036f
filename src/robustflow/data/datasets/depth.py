"""Depth maps of a pair: fill in missing measurements, transfer depth to the second frame, and check the result.

Missing depth is filled in from the neighbouring background, as KITTI's development kit fills disparity: along each row,
with the larger depth of the nearest measured pixels to the left and right; in rows without measurements, along each
column, with the larger depth of the nearest rows above and below. Beyond the outermost measured pixel, the only
neighbour is used.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import njit
from ...core.errors import DataError, first_line
from ...core.types import Camera, DepthMap, Flow, Mask, Sample, SceneDepth

SKY = 10_000.0
"""Depth of the sky, in metres."""
_NEAREST, _FARTHEST = 0.1, 10_000.0
"""Plausible range of the median depth, in metres; a median outside it suggests the wrong unit."""


def scene_depth(
    first: npt.NDArray[Any], second: npt.NDArray[Any], camera: Camera, source: str | Path, sample: Sample
) -> SceneDepth:
    """Return the depth of a pair from two maps, with holes filled in."""
    what = f"{source}, sample '{sample.key}'"
    maps, masks = [], []
    for number, values in enumerate((first, second), 1):
        check_size(values, sample.shape, f"{what}: the depth of frame {number}")
        map_, measured = completed(values, f"{what}, frame {number}")
        maps.append(map_)
        masks.append(measured)
    median = float(np.median(maps[0][masks[0]]))
    if not _NEAREST <= median <= _FARTHEST:
        warnings.warn(
            f"{source}: the median depth of a pair is {'below 0.1 m' if median < _NEAREST else 'above 10 km'}; check "
            "the unit (.npy and .pfm in metres, 16-bit .png in millimetres)",
            stacklevel=2,
        )
    return SceneDepth((maps[0], maps[1]), (masks[0], masks[1]), camera)


def check_size(values: npt.NDArray[Any], shape: tuple[int, int], what: str) -> None:
    """Raise a DataError unless a map has the size of the frames."""
    if values.shape != shape:
        size = "x".join(map(str, values.shape))
        raise DataError(f"{what} is {size}, but the frames are {shape[0]}x{shape[1]}; give a map of the same size")


def depth_of(disparity: npt.NDArray[Any], scale: float) -> npt.NDArray[np.float64]:
    """Return `scale` / disparity, float64, in metres; 0 where the disparity is not positive.

    >>> depth_of(np.array([[2.0, 0.0, np.nan, -1.0]]), 10.0).tolist()
    [[5.0, 0.0, 0.0, 0.0]]
    """
    out = np.zeros(disparity.shape)
    known = np.isfinite(disparity) & (disparity > 0)
    out[known] = scale / disparity[known].astype(np.float64)
    return out


def existing(files: list[Path], title: str, parts: str) -> list[Path]:
    """Return the files from which a dataset's depth is read."""
    for path in files:
        if not path.is_file():
            raise DataError(
                path,
                f"missing, but needed for the depth of {title}; unpack {parts} there, or give your own "
                "maps with --depth DIR",
            )
    return files


def table_of(path: Path, columns: int) -> npt.NDArray[np.float64]:
    """Read a camera file with `columns` finite numbers per line, float64 (N, columns)."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        table = np.array([[float(word) for word in line.split()] for line in lines if line.strip()], np.float64)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or first_line(error)
        raise DataError(path, f"cannot be read as numbers ({why}); restore the file") from error
    if table.ndim != 2 or table.shape[1] != columns or not np.isfinite(table).all():
        raise DataError(path, f"expected {columns} numbers on every line; restore the file")
    return table


def completed(values: npt.NDArray[Any], what: str = "the depth map") -> tuple[DepthMap, Mask]:
    """Return a map without holes, float32 (H, W), and the mask of measured pixels."""
    with np.errstate(over="ignore"):
        depth = np.array(values, np.float32, order="C")
    measured = np.isfinite(depth) & (depth != 0)
    if not measured.any():
        raise DataError(what, "no pixel has a measured depth; give a map with measurements")
    if (depth[measured] < 0).any():
        raise DataError(what, "contains negative depths; give distances along the optical axis, in front of the camera")
    if not measured.all():
        _fill(depth, measured)
    return depth, measured


def carried(depth: npt.NDArray[Any], flow: Flow, known: Mask) -> DepthMap:
    """Return the depth map of frame 2, computed from values at the pixels of frame 1."""
    out = np.zeros(known.shape, np.float32)
    _carry(np.ascontiguousarray(depth, np.float32), flow, known, out)
    return out


@njit(cache=True, nogil=True)
def _carry(depth: Any, flow: Any, known: Any, out: Any) -> None:
    height, width = out.shape
    for y in range(height):
        for x in range(width):
            if known[y, x]:
                u, v = np.rint(x + flow[y, x, 0]), np.rint(y + flow[y, x, 1])
                if 0 <= u < width and 0 <= v < height:
                    there = out[int(v), int(u)]
                    if there == 0 or depth[y, x] < there:
                        out[int(v), int(u)] = depth[y, x]


@njit(cache=True, nogil=True)
def _fill(depth: Any, measured: Any) -> None:
    height, width = depth.shape
    full = np.zeros(height, np.bool_)
    for y in range(height):
        last = -1
        for x in range(width):
            if measured[y, x]:
                for hole in range(last + 1, x):
                    depth[y, hole] = depth[y, x] if last < 0 else max(depth[y, last], depth[y, x])
                last = x
        full[y] = last >= 0
        if full[y]:
            for hole in range(last + 1, width):
                depth[y, hole] = depth[y, last]
    last = -1
    for y in range(height):
        if full[y]:
            for hole in range(last + 1, y):
                for x in range(width):
                    depth[hole, x] = depth[y, x] if last < 0 else max(depth[last, x], depth[y, x])
            last = y
    for hole in range(last + 1, height):
        for x in range(width):
            depth[hole, x] = depth[last, x]

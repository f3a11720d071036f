"""Depth of a pair: complete the maps, transfer them to the second frame, and find the camera's motion.

Missing depth is filled in from the neighbouring background, as KITTI's development kit fills disparity: along each row,
with the larger depth of the nearest measured pixels to the left and right; in rows without measurements, along each
column, with the larger depth of the nearest rows above and below. Beyond the outermost measured pixel, the only
neighbour is used.

The camera's motion follows from both poses, or from the depth of the first frame and the true flow: a robust
least-squares fit to the reprojection error in pixels, Gauss-Newton with weights (c^2 / (c^2 + r^2))^2, where c
decreases from 64 px to 1 px, so that independently moving objects lose weight. It uses only the four basic operations
and the square root, in a fixed order, so that the result is bit-identical on every machine.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import inner, njit
from ...core.errors import DataError
from ...core.types import Camera, DepthMap, Flow, Mask, Sample, SceneDepth
from ...media.arrays import readable

SKY = 10_000.0
"""Depth of the sky, in metres."""
_NEAREST, _FARTHEST = 0.1, 10_000.0
"""Plausible range of the median depth, in metres; a median outside it suggests the wrong unit."""


def scene_depth(
    first: npt.NDArray[Any],
    second: npt.NDArray[Any],
    camera: Camera,
    source: str | Path,
    sample: Sample,
    farthest: float = _FARTHEST,
) -> SceneDepth:
    """Return the depth of a pair from two maps, with holes filled in; warn if their median depth is implausible."""
    maps, masks = [], []
    for number, values in enumerate((first, second), 1):
        what = f"{source}, sample '{sample.key}', frame {number}"
        check_size(values, sample.shape, what)
        map_, measured = completed(values, what)
        maps.append(map_)
        masks.append(measured)
    median = float(np.median(maps[0][masks[0]]))
    if not _NEAREST <= median <= farthest:
        unit = "check the unit: .npy and .pfm are read in metres, .png in millimetres, or all as --depth-unit states"
        warnings.warn(f"{source}: the median depth of a pair is {median:.3g} m; {unit}", stacklevel=2)
    return SceneDepth((maps[0], maps[1]), (masks[0], masks[1]), camera)


def check_size(values: npt.NDArray[Any], shape: tuple[int, int], what: object) -> None:
    if values.shape != shape:
        size = "x".join(map(str, values.shape))
        raise DataError(what, f"the depth map is {size}, but the frames are {shape[0]}x{shape[1]}; resize it")


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
    for path in files:
        if not path.is_file():
            instead = f"unpack {parts} there, or give your own maps with --depth DIR"
            raise DataError(path, f"missing, but needed for the depth of {title}; {instead}")
    return files


def table_of(path: Path, columns: int) -> npt.NDArray[np.float64]:
    with readable(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of NumPy, for an empty file, which has no columns
        table = np.loadtxt(path, comments=None, ndmin=2, encoding="ascii")
    if table.shape[1] != columns or not np.isfinite(table).all():
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


_MOST, _LEAST = 20_000, 50
"""Maximum number of points used, and minimum number required."""
_SCALES = (*(64.0 / 2**step for step in range(7)), *(1.0,) * 12)
"""The value of c at each step, in pixels."""


Matrix = npt.NDArray[np.float64]


def relative_motion(first: Matrix, second: Matrix) -> tuple[Matrix, Matrix]:
    """Return the rotation (3, 3) and translation (3,) between two frames, see `Camera`."""
    before, after = first.tolist(), second.tolist()
    rotation = [[sum(a * b for a, b in zip(row[:3], column[:3], strict=True)) for column in before] for row in after]
    translation = [
        row[3] - sum(a * column[3] for a, column in zip(turned, before, strict=True))
        for row, turned in zip(after, rotation, strict=True)
    ]
    return np.array(rotation), np.array(translation)


def with_motion(camera: Camera, depth: npt.NDArray[Any], flow: Flow, known: Mask) -> Camera:
    """Return a camera with the motion that explains most of the flow, or the camera unchanged if too few points are
    known.
    """
    rows, columns = np.nonzero(known)
    step = max(1, -(-len(rows) // _MOST))
    rows, columns = rows[::step], columns[::step]
    if len(rows) < _LEAST:
        return camera
    fx, fy, cx, cy = camera.intrinsics(0)
    metres = depth[rows, columns].astype(np.float64)
    points = np.stack([(columns - cx) / fx * metres, (rows - cy) / fy * metres, metres], axis=1)
    targets = np.stack([columns, rows], axis=1) + flow[rows, columns].astype(np.float64)
    rotation, translation = np.eye(3), np.zeros(3)
    lens = np.array(camera.intrinsics(1), np.float64)
    if not _fit(points, targets, lens, np.array(_SCALES), rotation, translation):
        return camera
    return replace(camera, rotation=rotation, translation=translation)


@njit(cache=True, nogil=True)
def _fit(points: Any, targets: Any, lens: Any, scales: Any, rotation: Any, translation: Any) -> Any:
    """Write the motion into the output arrays; return False if the motion is not determined."""
    fx, fy, cx, cy = lens
    normal = np.empty((6, 7))
    row = np.empty((2, 6))
    for scale in scales:
        normal[:] = 0.0
        for i in range(points.shape[0]):
            a, b, c = points[i]
            x = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
            y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
            z = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
            px, py, pz = x + translation[0], y + translation[1], z + translation[2]
            if pz < 1e-3:
                continue
            u, v = px / pz, py / pz
            miss_u, miss_v = targets[i, 0] - (fx * u + cx), targets[i, 1] - (fy * v + cy)
            share = scale * scale / (scale * scale + miss_u * miss_u + miss_v * miss_v)
            weight = share * share
            # columns: a small rotation of the rotated point about x, y, z, then the translation
            gx, gy = fx / pz, fy / pz
            row[0, 0], row[0, 1], row[0, 2] = -gx * u * y, gx * (z + u * x), -gx * y
            row[0, 3], row[0, 4], row[0, 5] = gx, 0.0, -gx * u
            row[1, 0], row[1, 1], row[1, 2] = -gy * (z + v * y), gy * v * x, gy * x
            row[1, 3], row[1, 4], row[1, 5] = 0.0, gy, -gy * v
            for m in range(6):
                first, second = weight * row[0, m], weight * row[1, m]
                for n in range(m, 6):
                    normal[m, n] += first * row[0, n] + second * row[1, n]
                normal[m, 6] += first * miss_u + second * miss_v
        for m in range(6):
            for n in range(m):
                normal[m, n] = normal[n, m]
        if not _solve(normal):
            return False
        _turn(rotation, normal[0, 6], normal[1, 6], normal[2, 6])
        for m in range(3):
            translation[m] += normal[3 + m, 6]
    return True


@inner
def _solve(system: Any) -> Any:
    """Solve a symmetric positive definite system (6, 7) in place, with the solution in its last column; return False if
    the system is singular."""
    largest = 0.0
    for m in range(6):
        largest = max(largest, system[m, m])
    for m in range(6):
        if not system[m, m] > 1e-13 * largest:
            return False
        for below in range(6):
            if below != m:
                factor = system[below, m] / system[m, m]
                for n in range(m, 7):
                    system[below, n] -= factor * system[m, n]
    for m in range(6):
        system[m, 6] /= system[m, m]
    return True


@inner
def _turn(rotation: Any, wx: Any, wy: Any, wz: Any) -> None:
    """Rotate by a small rotation vector with the Cayley map, which gives an exact rotation without sines."""
    a, b, c = 0.5 * wx, 0.5 * wy, 0.5 * wz
    gain = 2.0 / (1.0 + a * a + b * b + c * c)
    step = np.empty((3, 3))
    step[0, 0], step[0, 1], step[0, 2] = 1 - gain * (b * b + c * c), gain * (a * b - c), gain * (a * c + b)
    step[1, 0], step[1, 1], step[1, 2] = gain * (a * b + c), 1 - gain * (a * a + c * c), gain * (b * c - a)
    step[2, 0], step[2, 1], step[2, 2] = gain * (a * c - b), gain * (b * c + a), 1 - gain * (a * a + b * b)
    before = rotation.copy()
    for m in range(3):
        for n in range(3):
            rotation[m, n] = step[m, 0] * before[0, n] + step[m, 1] * before[1, n] + step[m, 2] * before[2, n]

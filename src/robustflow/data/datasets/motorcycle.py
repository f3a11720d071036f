"""Compute the camera motion between two frames, from both camera poses or from the depth of the first frame and the
true flow. A real pair with dense ground truth that ships with scikit-image: Middlebury 2014's Motorcycle,
741x500.

The second method is a robust least-squares fit to the reprojection error in pixels against the true flow: Gauss-Newton
with weights (c^2 / (c^2 + r^2))^2, where c decreases from 64 px to 1 px, so that independently moving objects lose
weight. It uses only the four basic operations and the square root, in a fixed order, so that the result is
bit-identical on every machine.

A rectified stereo pair is optical flow without vertical motion: flow = (-disparity, 0) from the left to the right
image, unknown where the disparity is not finite. The depth is f B / (disparity + 31.086 px) with the calibrated f =
994.978 px and B = 193.001 mm; the depth of the right image is the left image's depth shifted by the disparity. Source:
Scharstein et al., GCPR 2014.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import skimage

from ...core.compiled import inner, njit
from ...core.errors import AssetError, UsageError
from ...core.types import Camera, Flow, Mask, Sample, SceneDepth
from ...media.arrays import readable
from ...media.images import read_image
from .base import DatasetFacts
from .depth import carried, scene_depth
from .pairs import Samples

_MOST, _LEAST = 20_000, 50
"""Maximum number of points used, and minimum number required."""
_SCALES = (*(64.0 / 2**step for step in range(7)), *(1.0,) * 12)
"""The value of c at each step, in pixels."""


Matrix = npt.NDArray[np.float64]


def relative_motion(first: Matrix, second: Matrix) -> tuple[Matrix, Matrix]:
    """Return the rotation (3, 3) and translation (3,) between two frames, see `Camera`."""
    one, other = first.tolist(), second.tolist()
    rotation = [[sum(a * b for a, b in zip(row[:3], column[:3], strict=True)) for column in one] for row in other]
    translation = [
        row[3] - sum(a * column[3] for a, column in zip(turned, one, strict=True))
        for row, turned in zip(other, rotation, strict=True)
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


_FOCAL, _CENTRE = 994.978, (311.193, 254.877)
_BASELINE = 0.193001
_OFFSET = 31.086
"""Difference between the x coordinates of the two principal points, in pixels."""


class Motorcycle(Samples):
    """The dataset with the single key "motorcycle". It needs neither a root folder nor a download."""

    name = "motorcycle"
    has_flow = True
    facts = DatasetFacts(
        title="Middlebury 2014 Motorcycle",
        description="One real stereo pair, 741x500, shipped with scikit-image; its flow is the negative disparity.",
        pairs=1,
        depth="its disparity",
        licence="distributed with scikit-image; see its notice on the Middlebury stereo data",
        citation="Scharstein et al., High-Resolution Stereo Datasets with Subpixel-Accurate Ground Truth, GCPR 2014",
        layout="no root needed",
        training_set="middlebury",
    )

    def __init__(self) -> None:
        folder = Path(skimage.__file__).parent / "data"
        self._files = [folder / f"motorcycle_{part}" for part in ("left.png", "right.png", "disp.npz")]
        for path in self._files:
            if not path.is_file():
                raise AssetError(
                    path,
                    "missing from this installation of scikit-image; reinstall its wheel: "
                    "pip install --force-reinstall --no-deps scikit-image",
                )

    def keys(self) -> list[str]:
        """See `Dataset.keys`."""
        return ["motorcycle"]

    def files(self, key: str) -> list[Path]:
        """See `Dataset.files`."""
        self._check(key)
        return list(self._files)

    def load(self, key: str) -> Sample:
        """See `Dataset.load`."""
        self._check(key)
        return Sample(key, (read_image(self._files[0]), read_image(self._files[1])), *self._truth())

    def depth(self, sample: Sample) -> SceneDepth:
        """See `Depths.depth`. The camera moves to the right by the baseline."""
        flow, valid = self._truth()
        depth = np.zeros(valid.shape, np.float32)
        depth[valid] = _FOCAL * _BASELINE / (_OFFSET - flow[valid, 0].astype(np.float64))
        right = (_FOCAL, _FOCAL, _CENTRE[0] + _OFFSET, _CENTRE[1])
        camera = Camera((_FOCAL, _FOCAL), _CENTRE, np.eye(3), np.array([-_BASELINE, 0.0, 0.0]), right)
        return scene_depth(depth, carried(depth, flow, valid), camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
        """See `Depths.depth_files`."""
        return self.files(key)[2:]

    def _truth(self) -> tuple[Flow, Mask]:
        with readable(self._files[2]), np.load(self._files[2], allow_pickle=False) as archive:
            disparity = archive["arr_0"]
        valid = np.isfinite(disparity)
        flow = np.zeros((*disparity.shape, 2), np.float32)
        flow[valid, 0] = -disparity[valid]
        return flow, valid

    def _check(self, key: str) -> None:
        if key != "motorcycle":
            raise UsageError(f"motorcycle has no sample '{key}'; its only key is 'motorcycle'")

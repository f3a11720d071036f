"""Regions of an image with ground truth, prepared once per sample, and the sums of errors in each.

    noc, occ                not occluded, occluded in frame 2: only where the dataset has an occlusion map
    s0_10, s10_40, s40      length of the ground truth: [0, 10), [10, 40), [40, inf) px  (MPI-Sintel's names)
    d0_10, d10_60, d60      distance to the nearest motion edge: [0, 10), [10, 60), [60, inf) px (see `edges`)

Each of the three lines splits the valid pixels without rest. A pixel carries one label for all three, so an
image is summed in one pass, in at most 18 sums, of which every region adds up its own in a fixed order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, types

from ..errors import DataError, unknown_name
from ..sample import Mask, Sample
from .edges import edge_distance, motion_edges
from .epe import ERRORS_TYPE, Errors, dense, magnitude_map
from .outliers import is_fl_outlier

REGIONS = ("noc", "occ", "s0_10", "s10_40", "s40", "d0_10", "d10_60", "d60")
MAGNITUDE_BOUNDS = (10.0, 40.0)
DISTANCE_BOUNDS = (10.0, 60.0)

_LABELS = 2 * 3 * 3
_OUTSIDE = 255
_GRID = np.arange(_LABELS).reshape(2, 3, 3)
_MEMBERS: dict[str, npt.NDArray[np.int64]] = {
    name: part.ravel()
    for name, part in zip(REGIONS, (*_GRID, *_GRID.transpose(1, 0, 2), *_GRID.transpose(2, 0, 1)), strict=True)
}
_LABELS_TYPE = types.Array(types.uint8, 2, "C", readonly=True)


class RegionSums(NamedTuple):
    """Over the `n` pixels of one region: sums of end-point error and RCRE in pixels, and Fl outliers."""

    n: int
    epe_sum: float
    rcre_sum: float
    fl_count: int


@dataclass(frozen=True, eq=False)
class Regions:
    """What the metrics need to know of a sample's ground truth, computed once.

    Attributes:
        names: the regions that exist for this sample, in the order of `REGIONS`.
        valid: bool (H, W), where the ground truth is known.
        magnitude: float64 (H, W), length of the ground truth in pixels (NaN-free inside `valid`).
        labels: uint8 (H, W), 0..17 inside `valid` and 255 outside.
    """

    names: tuple[str, ...]
    valid: Mask
    magnitude: Errors
    labels: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, sample: Sample) -> Regions | None:
        """The regions of a sample, or None where it has no ground truth.

        Raises:
            DataError: ground truth marked valid that is not finite.

        >>> import numpy as np
        >>> frame = np.zeros((4, 6, 3), np.uint8)
        >>> sample = Sample("a", (frame, frame), np.zeros((4, 6, 2), np.float32), np.ones((4, 6), bool))
        >>> regions = Regions.of(sample)
        >>> regions.names
        ('s0_10', 's10_40', 's40', 'd0_10', 'd10_60', 'd60')
        >>> int(regions.mask("s0_10").sum())
        24
        """
        if sample.flow is None or sample.valid is None:
            return None
        valid = np.ascontiguousarray(sample.valid, np.bool_)
        magnitude = magnitude_map(sample.flow)
        if np.isnan(magnitude[valid]).any():
            raise DataError(f"sample '{sample.key}': ground truth marked valid is not finite; mark such pixels invalid")
        distance = edge_distance(motion_edges(sample.flow, valid))
        label = 3 * _bin(magnitude, MAGNITUDE_BOUNDS) + _bin(distance, DISTANCE_BOUNDS)
        if sample.occluded is not None:
            label[np.asarray(sample.occluded, np.bool_)] += 9
        label[~valid] = _OUTSIDE
        names = REGIONS if sample.occluded is not None else REGIONS[2:]
        return cls(names, valid, magnitude, label)

    def mask(self, name: str) -> Mask:
        """The pixels of one region: bool (H, W), a part of `valid`."""
        if name not in self.names:
            raise unknown_name("region of this sample", name, self.names)
        return np.isin(self.labels, _MEMBERS[name])

    def sums(self, errors: Errors, rcre: Errors) -> dict[str, RegionSums]:
        """Sums of every region over the pixels where neither map is NaN.

        Args:
            errors: float64 (H, W), end-point errors in pixels.
            rcre: float64 (H, W), distances between the flow on corrupted and on clean frames in pixels.
        """
        count, total = _label_sums(*dense(errors, rcre, self.magnitude, self.labels))
        out = {}
        for name in self.names:
            labels = _MEMBERS[name]
            out[name] = RegionSums(
                int(count[0, labels].sum()),
                math.fsum(total[0, labels]),
                math.fsum(total[1, labels]),
                int(count[1, labels].sum()),
            )
        return out


def _bin(values: Errors, bounds: tuple[float, float]) -> npt.NDArray[np.uint8]:
    """0, 1 or 2: how many bounds each value reaches."""
    return (values >= bounds[0]).astype(np.uint8) + (values >= bounds[1]).astype(np.uint8)


@njit(
    types.Tuple((types.int64[:, ::1], types.float64[:, ::1]))(ERRORS_TYPE, ERRORS_TYPE, ERRORS_TYPE, _LABELS_TYPE),
    cache=True,
)
def _label_sums(errors: Any, rcre: Any, magnitude: Any, labels: Any) -> Any:
    count = np.zeros((2, _LABELS), np.int64)
    total = np.zeros((2, _LABELS), np.float64)
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            label = labels[y, x]
            if label == _OUTSIDE or math.isnan(errors[y, x]) or math.isnan(rcre[y, x]):
                continue
            count[0, label] += 1
            total[0, label] += errors[y, x]
            total[1, label] += rcre[y, x]
            count[1, label] += is_fl_outlier(errors[y, x], magnitude[y, x])
    return count, total

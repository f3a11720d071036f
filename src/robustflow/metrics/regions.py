"""Divide an image into regions by its ground truth; computed once per sample.

    noc, occ not occluded, occluded in frame 2; only if the dataset has occlusion maps
    s0_10, s10_40, s40      ground-truth flow magnitude: [0, 10), [10, 40), [40, inf) px  (MPI-Sintel's names)
    d0_10, d10_60, d60      distance to the nearest motion edge: [0, 10), [10, 60), [60, inf) px (see `edges`)

Each of the three lines is a partition of the valid pixels. A single label per pixel encodes all three partitions, so
one pass over an image (`row_sums`) computes at most 18 sums; the sum over a region adds the sums of its labels in a
fixed order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..compiled import types
from ..digest import quick_digest_of_bytes
from ..errors import DataError, unknown_name
from ..sample import Flow, Mask, Sample
from .edges import edge_distance, motion_edges
from .error_maps import Errors, magnitude_map

REGIONS = ("noc", "occ", "s0_10", "s10_40", "s40", "d0_10", "d10_60", "d60")
MAGNITUDE_BOUNDS = (10.0, 40.0)
DISTANCE_BOUNDS = (10.0, 60.0)

LABELS = 2 * 3 * 3
OUTSIDE = 255
_GRID = np.arange(LABELS).reshape(2, 3, 3)
MEMBERS: dict[str, npt.NDArray[np.int64]] = {
    name: part.ravel()
    for name, part in zip(REGIONS, (*_GRID, *_GRID.transpose(1, 0, 2), *_GRID.transpose(2, 0, 1)), strict=True)
}
LABELS_TYPE = types.Array(types.uint8, 2, "C", readonly=True)


@dataclass(frozen=True, eq=False)
class Regions:
    """Ground-truth quantities used by the metrics, computed once per sample."""

    names: tuple[str, ...]
    valid: Mask
    magnitude: Errors
    labels: npt.NDArray[np.uint8]
    truth_digest: str

    @classmethod
    def of(cls, sample: Sample) -> Regions | None:
        """Return the regions of a sample, or None if it has no ground truth."""
        if sample.flow is None or sample.valid is None:
            return None
        valid = np.ascontiguousarray(sample.valid)
        magnitude = magnitude_map(sample.flow)
        if np.isnan(magnitude[valid]).any():
            raise DataError(
                f"sample '{sample.key}': non-finite ground truth at valid pixels; mark these pixels invalid"
            )
        distance = edge_distance(motion_edges(sample.flow, valid))
        label = 3 * _bin(magnitude, MAGNITUDE_BOUNDS) + _bin(distance, DISTANCE_BOUNDS)
        if sample.occluded is not None:
            label[sample.occluded] += 9
        label[~valid] = OUTSIDE
        names = REGIONS if sample.occluded is not None else REGIONS[2:]
        return cls(names, valid, magnitude, label, _truth_digest(sample.flow, valid))

    def mask(self, name: str) -> Mask:
        """Return the mask of one region: bool (H, W), a subset of `valid`."""
        if name not in self.names:
            raise unknown_name("region of this sample", name, self.names)
        return np.isin(self.labels, MEMBERS[name])


def _truth_digest(flow: Flow, valid: Mask) -> str:
    """Hash the ground truth; values stored at unknown pixels do not affect the hash."""
    known = np.ascontiguousarray(flow[valid], "<f4")
    return quick_digest_of_bytes(str(valid.shape).encode(), np.packbits(valid).data, known.tobytes())


def _bin(values: Errors, bounds: tuple[float, float]) -> npt.NDArray[np.uint8]:
    """Return how many of the bounds each value reaches or exceeds: 0, 1 or 2."""
    return (values >= bounds[0]).astype(np.uint8) + (values >= bounds[1]).astype(np.uint8)

"""Find motion edges, i.e. discontinuities in the ground-truth flow, and each pixel's distance to the nearest edge.
Divide an image into regions by its ground truth; computed once per sample.

MPI-Sintel's d0-10, d10-60 and d60 are distances to occlusion boundaries rendered with the scenes. Real datasets do not
provide such maps, so edges are detected in the ground truth itself: there is an edge between two neighbours in a row or
column if their flows differ by more than 1 px and by more than 5 % of the larger flow magnitude (an absolute and a
relative threshold, as in Fl; without the relative one, most of a slanted road close to the camera would be marked as
edges). Sparse ground truth (KITTI) is often missing exactly at the edges, so a pixel's neighbours are the nearest
*valid* pixels in its row or column, up to 5 px away, and the difference must exceed the thresholds multiplied by their
distance. Both neighbours are marked as edge pixels.

    noc, occ not occluded, occluded in frame 2; only if the dataset has occlusion maps
    s0_10, s10_40, s40      ground-truth flow magnitude: [0, 10), [10, 40), [40, inf) px  (MPI-Sintel's names)
    d0_10, d10_60, d60      distance to the nearest motion edge: [0, 10), [10, 60), [60, inf) px (see `edges`)

Each of the three lines is a partition of the valid pixels. A single label per pixel encodes all three partitions, so
one pass over an image (`row_sums`) computes at most 18 sums; the sum over a region adds the sums of its labels in a
fixed order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..core.compiled import inner, njit_late
from ..core.errors import DataError
from ..core.files import quick_digest_of_bytes
from ..core.types import Flow, Mask, Sample
from .error_maps import ERRORS_TYPE, FLOW_TYPE, MASK_TYPE, Errors, dense, flow_array, magnitude_map

EDGE_PIXELS = 1.0
EDGE_SHARE = 0.05
EDGE_GAP = 5


def motion_edges(flow: Flow, valid: Mask) -> Mask:
    """Return the mask of the pixels on a motion edge."""
    edges = np.zeros(valid.shape, np.bool_)
    above = np.full(valid.shape[1], -1, np.int64)
    _mark_jumps(*dense(flow_array(flow), magnitude_map(flow), valid), above, edges)
    return edges


def edge_distance(edges: Mask) -> Errors:
    """Return each pixel's Euclidean distance to the nearest edge pixel: float64 (H, W), in pixels; infinite if there is
    no edge. Beyond 1000 pixels, the square of a distance may be wrong by 3.
    """
    if not edges.any():
        return np.full(edges.shape, np.inf)
    # importing scipy.ndimage would take three times as long as this computation, in every worker process
    distance = cv2.distanceTransform((~edges).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.sqrt(np.rint(np.square(distance, dtype=np.float64))))


@inner
def _jumps(flow: Any, magnitude: Any, y0: Any, x0: Any, y1: Any, x1: Any, gap: Any) -> Any:
    """Return whether the motion differs by more than a pixel and 5 % per pixel of distance `gap`."""
    du = np.float64(flow[y0, x0, 0]) - np.float64(flow[y1, x1, 0])
    dv = np.float64(flow[y0, x0, 1]) - np.float64(flow[y1, x1, 1])
    jump, longer = math.sqrt(du * du + dv * dv), np.maximum(magnitude[y0, x0], magnitude[y1, x1])
    return jump > gap * EDGE_PIXELS and jump > gap * (EDGE_SHARE * longer)


@njit_late(f"void({FLOW_TYPE}, {ERRORS_TYPE}, {MASK_TYPE}, int64[::1], boolean[:, ::1])", cache=True)
def _mark_jumps(flow: Any, magnitude: Any, valid: Any, above: Any, edges: Any) -> None:
    """Mark the edges; `above` contains the row of the nearest valid pixel above each column, at first -1."""
    for y in range(valid.shape[0]):
        left = -1
        for x in range(valid.shape[1]):
            if not valid[y, x]:
                continue
            gap = x - left
            if left >= 0 and gap <= EDGE_GAP and _jumps(flow, magnitude, y, x, y, left, gap):
                edges[y, x] = edges[y, left] = True
            gap = y - above[x]
            if above[x] >= 0 and gap <= EDGE_GAP and _jumps(flow, magnitude, y, x, above[x], x, gap):
                edges[y, x] = edges[above[x], x] = True
            left = x
            above[x] = y


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
            raise DataError(sample.key, "the ground truth is not finite at valid pixels; mark these pixels invalid")
        distance = edge_distance(motion_edges(sample.flow, valid))
        label = 3 * _bin(magnitude, MAGNITUDE_BOUNDS) + _bin(distance, DISTANCE_BOUNDS)
        if sample.occluded is not None:
            label[sample.occluded] += 9
        label[~valid] = OUTSIDE
        names = REGIONS if sample.occluded is not None else REGIONS[2:]
        return cls(names, valid, magnitude, label, _truth_digest(sample.flow, valid))


def _truth_digest(flow: Flow, valid: Mask) -> str:
    """Hash the ground truth; values stored at unknown pixels do not affect the hash."""
    known = np.ascontiguousarray(flow[valid], "<f4")
    return quick_digest_of_bytes(str(valid.shape).encode(), np.packbits(valid).data, known.tobytes())


def _bin(values: Errors, bounds: tuple[float, float]) -> npt.NDArray[np.uint8]:
    """Return how many of the bounds each value reaches or exceeds: 0, 1 or 2."""
    return (values >= bounds[0]).astype(np.uint8) + (values >= bounds[1]).astype(np.uint8)

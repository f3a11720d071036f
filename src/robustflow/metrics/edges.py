"""Find motion edges, i.e. discontinuities in the ground-truth flow, and each pixel's distance to the nearest edge.

MPI-Sintel's d0-10, d10-60 and d60 are distances to occlusion boundaries rendered with the scenes. Real datasets do not
provide such maps, so edges are detected in the ground truth itself: there is an edge between two neighbours in a row or
column if their flows differ by more than 1 px and by more than 5 % of the larger flow magnitude (an absolute and a
relative threshold, as in Fl; without the relative one, most of a slanted road close to the camera would be marked as
edges). Sparse ground truth (KITTI) is often missing exactly at the edges, so a pixel's neighbours are the nearest
*valid* pixels in its row or column, up to 5 px away, and the difference must exceed the thresholds multiplied by their
distance. Both neighbours are marked as edge pixels.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from ..compiled import inner, njit_late, types
from ..sample import Flow, Mask
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
    du = np.float64(flow[y0, x0, 0]) - np.float64(flow[y1, x1, 0])
    dv = np.float64(flow[y0, x0, 1]) - np.float64(flow[y1, x1, 1])
    longer = max(magnitude[y0, x0], magnitude[y1, x1])
    return math.sqrt(du * du + dv * dv) > gap * max(EDGE_PIXELS, EDGE_SHARE * longer)


@njit_late(types.void(FLOW_TYPE, ERRORS_TYPE, MASK_TYPE, types.int64[::1], types.boolean[:, ::1]), cache=True)
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

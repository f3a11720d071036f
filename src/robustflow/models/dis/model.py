"""Dense inverse search on RGB frames, the version of DIS that the benchmark's paper ran."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from ...errors import unknown_name
from ...sample import Flow, Frame
from ..pairs import check_pair
from .densify import densified
from .operating_point import OPERATING_POINTS
from .pyramid import enlarged, pyramid
from .refine import refined
from .search import inverse_search


class DisRgb:
    """Kroeger, Timofte, Dai, Van Gool: "Fast Optical Flow using Dense Inverse Search" (ECCV 2016), on colours.

    From coarse to fine: patches search along their slopes, their displacements become a dense flow, that is refined.
    Written from the paper; where it gives no detail, chosen by error on real pairs (docs/dis-rgb.md).

    The first pair of an installation takes some seconds more, in which the loops are compiled; they are kept on disk.

    Args:
        operating_point: 1 (fastest) to 4 (most accurate), the paper's. 2, the default, is that of the authors'
            program, which the benchmark's paper ran as it comes; its flow is found at an eighth of the size of
            frames 640 px wide or wider, and nearer to full size in smaller ones.

    >>> frame = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    >>> flow = DisRgb().predict(frame, frame)
    >>> flow.shape, flow.dtype, bool(abs(flow).max() < 1e-4)
    ((48, 64, 2), dtype('float32'), True)
    """

    single_threaded = True

    def __init__(self, operating_point: int = 2) -> None:
        if operating_point not in OPERATING_POINTS:
            raise unknown_name("operating point of DIS", str(operating_point), map(str, OPERATING_POINTS))
        self._number = int(operating_point)

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`: the operating point with all that it stands for."""
        point = asdict(OPERATING_POINTS[self._number])
        return {"name": "dis_rgb", "operating_point": self._number, **point, "interpolation": "cubic spline"}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`. Frames of any size; motion up to a fifth of the longer side is within reach.

        Raises:
            ModelError: frames that are not RGB uint8 of one size.
        """
        check_pair("dis_rgb", frame1, frame2)
        point = OPERATING_POINTS[self._number]
        height, width = frame1.shape[:2]
        coarsest, finest = point.scales(height, width)
        # Every scale is exactly half the one before, and the coarsest has room for a patch.
        full_height, full_width = (max(-(-side >> coarsest) << coarsest, point.patch_size) for side in (height, width))
        images1 = pyramid(frame1, full_height, full_width, coarsest)
        images2 = pyramid(frame2, full_height, full_width, coarsest)
        flow: Flow = np.zeros((1, 1, 2), np.float32)
        for scale in range(coarsest, finest - 1, -1):
            image1, image2 = images1[scale], images2[scale]
            displacements = inverse_search(image1, image2, flow, point.patch_size, point.stride, point.iterations)
            flow = densified(image1, image2, displacements, point.patch_size, point.stride)
            if point.refined:
                flow = refined(image1, image2, flow, iterations=scale + 1)
        return enlarged(flow, 1 << finest, height, width)

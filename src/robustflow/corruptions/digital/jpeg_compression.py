"""Compress frames as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from ...core.errors import RobustFlowError
from ...core.rng import Rng
from ...core.types import Frame
from ..base import Corruption


class JpegCompression(Corruption):
    """Applies baseline JPEG compression with 4:2:0 chroma subsampling; the severity parameter is the quality (paper,
    "JPEG compression").
    """

    name = "jpeg_compression"
    family = "digital"
    paper_severities = (25, 18, 15, 10, 7)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> int:
        return int(self.parameter(severity))

    def apply(self, frame: Frame, state: int, index: int) -> Frame:
        bgr = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, state])
        if not done:
            raise RobustFlowError(f"OpenCV cannot encode a JPEG of {frame.shape[0]}x{frame.shape[1]} pixels")
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB, dst=decoded)

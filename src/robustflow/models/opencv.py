"""The knowledge-driven methods in OpenCV: Farneback and (grey) DIS.

OpenCV splits DIS into as many stripes as it has threads, and the stripes change the result; therefore both adapters run
on one OpenCV thread, which makes the flow the same on every machine.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from ..errors import ModelError, UsageError, unknown_name
from ..sample import Flow, Frame
from ..threads import one_opencv_thread
from .option_checks import check_count


class Farneback:
    """Gunnar Farneback's polynomial expansion (2003) on grey frames, at the paper's OpenCV defaults.

    Args:
        pyr_scale: size of each scale relative to the previous one, above 0 and below 1.
        levels: number of scales in addition to the full size.
        winsize: side of the window that flow is averaged over, in pixels.
        iterations: at each scale.
        poly_n: side of the neighbourhood that a polynomial is fitted to, in pixels.
        poly_sigma: standard deviation of the weights of that neighbourhood, in pixels.

    Raises:
        UsageError: a parameter out of these ranges.

    >>> import numpy as np
    >>> frame = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    >>> Farneback().predict(frame, frame).shape
    (64, 96, 2)
    """

    single_threaded = True

    def __init__(
        self,
        pyr_scale: float = 0.5,
        levels: int = 3,
        winsize: int = 15,
        iterations: int = 3,
        poly_n: int = 5,
        poly_sigma: float = 1.2,
    ) -> None:
        for name, value, least in (
            ("levels", levels, 0),
            ("winsize", winsize, 1),
            ("iterations", iterations, 1),
            ("poly_n", poly_n, 1),
        ):
            check_count(name, value, least)  # OpenCV accepts smaller values, and then crashes or returns NaN
        for name, number, limit in (("pyr_scale", pyr_scale, 1.0), ("poly_sigma", poly_sigma, np.inf)):
            if not isinstance(number, int | float) or not 0 < number < limit:
                raise UsageError(f"{name} must be a number above 0{' and below 1' * (limit == 1)}, not {number!r}")
        self._parameters: dict[str, Any] = {
            "pyr_scale": pyr_scale,
            "levels": levels,
            "winsize": winsize,
            "iterations": iterations,
            "poly_n": poly_n,
            "poly_sigma": poly_sigma,
        }

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`: the parameters, and the version of OpenCV."""
        return {"name": "farneback", "opencv": cv2.__version__, **self._parameters}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`."""
        grey1, grey2 = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2))
        with one_opencv_thread():
            flow = cv2.calcOpticalFlowFarneback(grey1, grey2, None, flags=0, **self._parameters)
        return np.asarray(flow, np.float32)


class Dis:
    """Dense inverse search (Kroeger et al. 2016) in OpenCV's version: on grey frames.

    Args:
        preset: "ultrafast", "fast" or "medium" (default).

    Raises:
        UsageError: another preset.
    """

    single_threaded = True
    PRESETS = ("ultrafast", "fast", "medium")

    def __init__(self, preset: str = "medium") -> None:
        if preset not in self.PRESETS:
            raise unknown_name("DIS preset", str(preset), self.PRESETS)
        self._preset = preset

    def identity(self) -> dict[str, Any]:
        """See `FlowModel`: the preset, and the version of OpenCV."""
        return {"name": "dis", "preset": self._preset, "opencv": cv2.__version__}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """See `FlowModel.predict`.

        Raises:
            ModelError: frames below 8 pixels on one side, or below 12 on both, for which OpenCV has no pyramid.
        """
        height, width = frame1.shape[:2]
        if min(height, width) < 8 or max(height, width) < 12:
            raise ModelError(
                f"dis needs frames of 8x12 pixels or more, not {height}x{width}; give larger ones, or model dis_rgb"
            )
        grey1, grey2 = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2))
        with one_opencv_thread():
            # A new object per pair: otherwise DIS starts from the previous flow.
            method = cv2.DISOpticalFlow.create(self.PRESETS.index(self._preset))
            flow = method.calc(grey1, grey2, None)
        return np.asarray(flow, np.float32)

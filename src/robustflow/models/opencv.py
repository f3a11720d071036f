"""The knowledge-driven methods in OpenCV: Farneback and DIS on greyscale frames.

For DIS, OpenCV splits the frame into as many stripes as it has threads, and the stripes change the result; therefore
both adapters use a single OpenCV thread, which yields the same flow on every machine.
"""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np

from ..core.arguments import check_count
from ..core.errors import ModelError, UsageError, unknown_name
from ..core.opencv import one_opencv_thread
from ..core.types import Flow, Frame
from .pair_network import check_pair


class Farneback:
    """Gunnar Farneback's polynomial expansion (2003) on greyscale frames.

    Args:
        preset: "samples" for the values of OpenCV's sample programs, or "opencv" for the defaults of its class
            `FarnebackOpticalFlow`; parameters that are given replace those of the preset.
        pyr_scale, levels, winsize, iterations, poly_n, poly_sigma: as in `cv2.calcOpticalFlowFarneback`.
    """

    single_threaded = True
    PRESETS: ClassVar = {
        "samples": {"levels": 3, "winsize": 15, "iterations": 3, "poly_n": 5, "poly_sigma": 1.2},
        "opencv": {"levels": 5, "winsize": 13, "iterations": 10, "poly_n": 5, "poly_sigma": 1.1},
    }

    def __init__(
        self,
        preset: str = "samples",
        pyr_scale: float = 0.5,
        levels: int | None = None,
        winsize: int | None = None,
        iterations: int | None = None,
        poly_n: int | None = None,
        poly_sigma: float | None = None,
    ) -> None:
        if preset not in self.PRESETS:
            raise unknown_name("Farneback preset", str(preset), self.PRESETS)
        given: dict[str, Any] = {"levels": levels, "winsize": winsize, "iterations": iterations, "poly_n": poly_n}
        given["poly_sigma"] = poly_sigma
        values: dict[str, Any] = {"pyr_scale": pyr_scale, **self.PRESETS[preset]}
        values |= {name: value for name, value in given.items() if value is not None}
        counts = {name: values[name] for name in ("levels", "winsize", "iterations", "poly_n")}
        for name, value in counts.items():  # OpenCV accepts smaller values, but then crashes or returns NaN
            check_count(name, value, least=0 if name == "levels" else 1)
        for name, limit in (("pyr_scale", 1.0), ("poly_sigma", np.inf)):
            if not isinstance(number := values[name], int | float) or not 0 < number < limit:
                raise UsageError(name, f"must be a number above 0{' and below 1' * (limit == 1)}, not {number!r}")
        self._parameters = values

    def identity(self) -> dict[str, Any]:
        """Return the identity: the parameters and the OpenCV version."""
        return {"name": "farneback", "opencv": cv2.__version__, **self._parameters}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`."""
        check_pair(frame1, frame2)
        grey1, grey2 = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2))
        with one_opencv_thread():
            flow = cv2.calcOpticalFlowFarneback(grey1, grey2, None, flags=0, **self._parameters)
        return np.asarray(flow, np.float32)


class Dis:
    """OpenCV's implementation of dense inverse search (Kroeger et al. 2016), on greyscale frames."""

    single_threaded = True
    PRESETS = ("ultrafast", "fast", "medium")

    def __init__(self, preset: str = "medium") -> None:
        if preset not in self.PRESETS:
            raise unknown_name("DIS preset", str(preset), self.PRESETS)
        self._preset = preset

    def identity(self) -> dict[str, Any]:
        """Return the identity: the preset and the OpenCV version."""
        return {"name": "dis", "preset": self._preset, "opencv": cv2.__version__}

    def predict(self, frame1: Frame, frame2: Frame) -> Flow:
        """Predict a flow as in `FlowModel.predict`."""
        check_pair(frame1, frame2)
        height, width = frame1.shape[:2]
        # A new object for each pair; otherwise DIS would start from the previous flow.
        method = cv2.DISOpticalFlow.create(self.PRESETS.index(self._preset))
        least = _least_height(width, method.getFinestScale())
        if width < 8 or height < least:
            why = f"too small for preset {self._preset} of dis, which needs {least} rows at this width, and 8 columns"
            raise ModelError(f"{height}x{width}", f"{why}; use model dis_rgb")
        grey1, grey2 = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2))
        with one_opencv_thread():
            flow = method.calc(grey1, grey2, None)
        return np.asarray(flow, np.float32)


def _least_height(width: int, finest: int) -> int:
    """Return the smallest height that OpenCV's DIS can process. If a frame has no room for the preset's finest scale,
    the coarsest scale depends on the width alone, log2(width / 20), and may have no room for a patch of 8 pixels: then
    OpenCV reads outside of the frame. Below 12 pixels on both sides, it refuses.
    """
    return max(8 if width >= 12 else 12, 8 << min(finest, max(0, (width // 20).bit_length() - 1)))

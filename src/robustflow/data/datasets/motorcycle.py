"""Middlebury 2014's Motorcycle, 741x500: a real pair with dense ground truth that ships with scikit-image.

A rectified stereo pair is optical flow without vertical motion: flow = (-disparity, 0) from the left to the right
image, unknown where the disparity is not finite. The depth is f B / (disparity + 31.086 px) with the calibrated f =
994.978 px and B = 193.001 mm; the depth of the right image is the left image's depth shifted by the disparity. Source:
Scharstein et al., GCPR 2014.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import skimage

from ...core.errors import AssetError, UsageError
from ...core.types import Camera, Flow, Mask, Sample, SceneDepth
from ...media.arrays import readable
from ...media.images import read_image
from .dataset import DatasetFacts
from .depth import carried, scene_depth
from .pair_files import Samples

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
                wheel = "pip install --force-reinstall --no-deps scikit-image"
                raise AssetError(path, f"missing from this installation of scikit-image; reinstall its wheel: {wheel}")

    def keys(self) -> list[str]:
        return ["motorcycle"]

    def files(self, key: str) -> list[Path]:
        self._check(key)
        return list(self._files)

    def load(self, key: str) -> Sample:
        self._check(key)
        return Sample(key, (read_image(self._files[0]), read_image(self._files[1])), *self._truth())

    def depth(self, sample: Sample) -> SceneDepth:
        """Return the depth; the camera moves to the right by the baseline."""
        flow, valid = self._truth()
        depth = np.zeros(valid.shape, np.float32)
        depth[valid] = _FOCAL * _BASELINE / (_OFFSET - flow[valid, 0].astype(np.float64))
        right = (_FOCAL, _FOCAL, _CENTRE[0] + _OFFSET, _CENTRE[1])
        camera = Camera((_FOCAL, _FOCAL), _CENTRE, np.eye(3), np.array([-_BASELINE, 0.0, 0.0]), right)
        return scene_depth(depth, carried(depth, flow, valid), camera, self.name, sample)

    def depth_files(self, key: str) -> list[Path]:
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
            raise UsageError(key, "no such sample; the only key of motorcycle is 'motorcycle'")

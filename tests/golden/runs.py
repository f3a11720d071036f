"""Small runs that together use every way of measuring, with models whose flow is the same on every machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import robustflow as rf
from robustflow.corruptions import IMAGE_PAIR
from robustflow.media.images import write_image
from robustflow.models import ModelRef
from robustflow.run.run import Run
from robustflow.testing import TexturePairs

from ..made_rows import made_run
from ..shared_data import shared_folder
from .own import Stripes, brightness_flow, partly_invalid_flow

DIS = ModelRef.parse("dis", {"preset": "ultrafast"})


@dataclass(frozen=True)
class GoldenRun:
    """The arguments of `evaluate`; `data` makes or finds the data, and `drop` removes rows afterwards."""

    model: Any = brightness_flow
    benchmark: str = "demo"
    options: dict[str, Any] = field(default_factory=dict)
    data: Callable[[Path], Path] | None = None
    drop: bool = False

    def run(self, folder: Path) -> Run:
        """Measure in an empty folder."""
        data = self.data(folder / "data") if self.data else None
        result = rf.evaluate(self.model, self.benchmark, data, folder / "run", examples=False, **self.options)
        return made_run(result, result.rows.gather_every(2), "with gaps") if self.drop else result


def _own_frames(folder: Path) -> Path:
    """Three frames of a texture in motion, in a folder."""
    folder.mkdir(parents=True)
    for key in ("0", "1", "2"):
        write_image(folder / f"{key}.png", TexturePairs(3, (72, 96)).load(key).frames[0])
    return folder


FEW = {"corruptions": ["jpeg_compression", "fog", "gaussian_noise"], "severities": [1, 5]}
SHAPES = FEW | {"data_options": {"pairs": 10, "size": "96x128"}}
GOLDEN_RUNS = {
    "embedded pair": GoldenRun(options={"corruptions": [n for n in IMAGE_PAIR if n != "frost"], "severities": [3]}),
    "embedded pair, DIS": GoldenRun(DIS, options={"corruptions": FEW["corruptions"], "severities": [1, 3, 5]}),
    "shapes": GoldenRun(DIS, "shapes", SHAPES),
    "shapes, other model": GoldenRun(brightness_flow, "shapes", SHAPES),
    "KITTI": GoldenRun(DIS, "kitti2015", FEW | {"limit": 2}, lambda _: shared_folder("data/kitti2015")),
    "own frames": GoldenRun(DIS, "folder", FEW, _own_frames),
    "still": GoldenRun(DIS, "folder", FEW | {"still": True, "draws": 2}, _own_frames),
    "missing rows": GoldenRun(brightness_flow, "shapes", SHAPES, drop=True),
    "invalid pixels": GoldenRun(partly_invalid_flow, "shapes", SHAPES | {"allow_invalid": True}),
    "attack": GoldenRun(
        brightness_flow, "shapes", {**SHAPES, "corruptions": None, "attacks": ["square:queries=4"], "limit": 2}
    ),
    "confidence": GoldenRun(DIS, "shapes", SHAPES | {"confidence": "forward-backward"}),
    "calibrated": GoldenRun(options=FEW | {"severity_scale": "calibrated"}),
    "stack": GoldenRun(options={"corruptions": ["fog:2+jpeg_compression"], "severities": [2, 4], "seed": 7}),
    "own corruption": GoldenRun(options={"corruptions": [Stripes], "severities": [1, 5]}),
    "without truth": GoldenRun(options={"corruptions": ["elastic_transform", "contrast"], "severities": [2]}),
    "depth and sensor": GoldenRun(options={"corruptions": ["fog_3d", "far_focus", "raw_noise"], "severities": [4]}),
}
COMPARED = ("shapes", "shapes, other model")

"""Compare the end-point error and time of `dis_rgb` with those of OpenCV's greyscale `dis` in one run.

    python bench/dis_rgb.py [--data kitti2015=~/kitti2015 middlebury=~/middlebury ...] [--points 1,2,3] [--rounds 3]

The script prints the mean end-point error in pixels and the median milliseconds with one thread, for each pair and
averaged over each dataset (by default for the embedded pair only). There is one column for each operating point of
`dis_rgb`; for OpenCV with the same scales, patches and iterations, with and without spatial propagation (which the
paper's method does not have); and for OpenCV's presets.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from robustflow import load_model
from robustflow.core.types import Flow, Frame, Sample
from robustflow.data.datasets import load_dataset
from robustflow.metrics import epe
from robustflow.models.dis.dis_rgb import OPERATING_POINTS

Predict = Callable[[Frame, Frame], Flow]


def opencv(number: int, propagation: bool) -> Predict:
    """OpenCV's method at the given operating point."""
    point = OPERATING_POINTS[number]

    def predict(frame1: Frame, frame2: Frame) -> Any:
        _, finest = point.scales(*frame1.shape[:2])
        method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        method.setFinestScale(finest)
        method.setPatchSize(point.patch_size)
        method.setPatchStride(point.stride)
        method.setGradientDescentIterations(point.iterations)
        method.setVariationalRefinementIterations(5 if point.refined else 0)
        method.setUseSpatialPropagation(propagation)
        return method.calc(*(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (frame1, frame2)), None)

    return predict


def methods(points: list[int]) -> dict[str, Predict]:
    """The compared methods, by column heading."""
    columns: dict[str, Predict] = {}
    for number in points:
        columns[f"dis_rgb {number}"] = load_model("dis_rgb", operating_point=number).predict
        columns[f"OpenCV {number}"] = opencv(number, True)
        columns[f"no prop. {number}"] = opencv(number, False)
    for preset in ("ultrafast", "fast", "medium"):
        columns[preset] = load_model("dis", preset=preset).predict
    return columns


def samples(data: list[str]) -> Iterator[tuple[str, Sample]]:
    """Every pair with ground truth, as dataset and sample."""
    for name, _, root in (entry.partition("=") for entry in data or ["motorcycle"]):
        options: dict[str, Any] = {"root": Path(root).expanduser()} if root else {}
        if name == "kitti2012":
            options["images"] = "grey" if (options["root"] / "training" / "image_0").is_dir() else "colour"
        dataset = load_dataset(name, **options)
        for key in list(dataset.keys()):
            sample = dataset.load(key)
            if sample.flow is not None:
                yield Path(root).name or name, sample


def measured(predict: Predict, sample: Sample, rounds: int) -> tuple[float, float]:
    """Error in pixels, and median milliseconds after a warm-up round, which compiles functions and fills caches."""
    assert sample.flow is not None
    flow, times = predict(*sample.frames[:2]), []
    for _ in range(rounds):
        start = time.perf_counter()
        predict(*sample.frames[:2])
        times.append(1e3 * (time.perf_counter() - start))
    error = epe(flow, sample.flow, sample.valid)
    return float("nan") if error is None else error, float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="*", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--points", default="1,2,3")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    columns = methods([int(number) for number in options.points.split(",")])
    print(f"{'EPE px / ms':30s}" + "".join(f"{heading:>15s}" for heading in columns))
    of_set: dict[str, list[list[tuple[float, float]]]] = {}
    for name, sample in samples(options.data):
        line = [measured(predict, sample, options.rounds) for predict in columns.values()]
        of_set.setdefault(name, []).append(line)
        print(f"{sample.key[:29]:30s}" + "".join(f"{error:9.3f} /{ms:4.0f}" for error, ms in line), flush=True)
    for name, lines in of_set.items():
        means = np.mean(lines, axis=0)
        label = f"mean of {len(lines)} of {name}"
        print(f"{label[:29]:30s}" + "".join(f"{error:9.3f} /{ms:4.0f}" for error, ms in means))


if __name__ == "__main__":
    main()

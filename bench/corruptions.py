"""How many milliseconds each corruption takes per pair, beside `imagecorruptions-imaug` in the same run.

    python bench/corruptions.py [--size 375x1242] [--images A.png B.png] [--threads 2]

One thread, processor time. Every figure is the mean over the five severities of the best of several rounds (each
draws and applies to both frames); ours and theirs take turns. The other package is timed where it is installed and
has the same corruption. It brings a second OpenCV, which would overwrite ours, so install it without its dependencies
(ours will do): `pip install --no-deps imagecorruptions-imaug`.

Corruptions that need depth get that of the embedded pair, resized like it; for other images a road: the ground 1.65 m
below the camera, which drives forward by 1 m.

`--threads N` measures instead how many times faster N threads, and N processes, finish the same work than one.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import importlib
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from robustflow.corruptions import corrupt
from robustflow.corruptions.registry import FURTHER, IMAGE_PAIR
from robustflow.datasets.motorcycle import Motorcycle
from robustflow.errors import AssetError
from robustflow.images.io import read_image
from robustflow.sample import Camera, SceneDepth

SEVERITIES = (1, 2, 3, 4, 5)
FURTHER_NAMES = tuple(name for names in FURTHER.values() for name in names)
THEIR_NAMES = {"high_light": "brightness", "camera_motion_blur": "motion_blur"}
Pair = tuple[np.ndarray, np.ndarray]


def load_pair(images: list[Path] | None, size: str | None) -> Pair:
    """The images, or the embedded pair, resized to "HxW"."""
    frames = [read_image(path) for path in images] if images else Motorcycle().load("motorcycle").frames[:2]
    if size or not images:
        height, width = map(int, (size or "375x1242").split("x"))
        frames = [cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in frames]
    return np.ascontiguousarray(frames[0]), np.ascontiguousarray(frames[1])


def load_depth(images: list[Path] | None, shape: tuple[int, int]) -> SceneDepth:
    """Of the images, or of the embedded pair, at `shape` (H, W)."""
    height, width = shape
    known = np.ones(shape, bool)
    if images:
        rows = np.arange(height, dtype=np.float32)[:, None].repeat(width, axis=1)
        road = np.minimum(1.65 * 0.6 * width / np.maximum(rows - 0.45 * height, 1e-3), 80)
        camera = Camera((0.6 * width,) * 2, (width / 2, 0.45 * height), np.eye(3), np.array([0.0, 0.0, -1.0]))
        return SceneDepth((road, road), (known, known), camera)
    data = Motorcycle()
    sample = data.load("motorcycle")
    depth = data.depth(sample)
    first, second = (cv2.resize(one, (width, height), interpolation=cv2.INTER_NEAREST) for one in depth.maps)
    across, down = width / sample.shape[1], height / sample.shape[0]
    old = depth.camera
    focal, centre = (old.focal[0] * across, old.focal[1] * down), (old.centre[0] * across, old.centre[1] * down)
    return SceneDepth((first, second), (known, known), Camera(focal, centre, old.rotation, old.translation))


def best_of(jobs: list[Callable[[], Any]], seconds: float) -> list[float]:
    """Best processor milliseconds of each job; they take turns for at least `seconds` and three rounds."""
    for job in jobs:
        job()  # compiles, fills caches
    best, rounds, end = [float("inf")] * len(jobs), 0, time.perf_counter() + seconds
    while rounds < 3 or time.perf_counter() < end:
        for i, job in enumerate(jobs):
            start = time.process_time()
            job()
            best[i] = min(best[i], 1e3 * (time.process_time() - start))
        rounds += 1
    return best


def other_package() -> Any:
    """`imagecorruptions`, or None."""
    try:
        return importlib.import_module("imagecorruptions")
    except ImportError:
        return None


def measure(name: str, pair: Pair, depth: SceneDepth, theirs: Any, seconds: float) -> tuple[float, float | None]:
    """Mean over severities of ms per pair, ours and theirs (None where they do not have it)."""
    their_name = THEIR_NAMES.get(name, name)
    if theirs is not None and their_name not in theirs.get_corruption_names("all"):
        theirs = None
    rows = []
    for severity in SEVERITIES:
        jobs: list[Callable[[], Any]] = [lambda s=severity: corrupt(*pair, name, s, depth=depth)]  # type: ignore[misc]
        if theirs is not None:
            jobs.append(lambda s=severity: [theirs.corrupt(frame, s, their_name) for frame in pair])  # type: ignore[misc]
        rows.append(best_of(jobs, seconds / len(SEVERITIES)))
    means = np.mean(rows, axis=0)
    return float(means[0]), float(means[1]) if len(means) > 1 else None


def table(names: list[str], pair: Pair, depth: SceneDepth, seconds: float) -> None:
    theirs = other_package()
    copy = best_of([lambda: [frame.copy() for frame in pair]], 0.2)[0]
    height, width = pair[0].shape[:2]
    print(f"ms per pair, {height}x{width}, one thread, mean over severities; copying the pair takes {copy:.2f} ms")
    if theirs is None:
        print("imagecorruptions is not installed (pip install --no-deps imagecorruptions-imaug): no comparison")
    print(f"{'corruption':20} {'ours':>8} {'copies':>8} {'imagecorruptions':>17} {'ratio':>7}")
    sums = {"psf_blur": 0.0, "others": 0.0, "shared, ours": 0.0, "shared, theirs": 0.0}
    for name in names:
        try:
            ours, their = measure(name, pair, depth, theirs, seconds)
        except AssetError as error:
            print(f"{name:20} left out: {error}")
            continue
        sums["psf_blur" if name == "psf_blur" else "others"] += ours
        if their is not None:
            sums["shared, ours"] += ours
            sums["shared, theirs"] += their
        text = f"{their:17.1f} {their / ours:7.1f}" if their is not None else f"{'-':>17} {'-':>7}"
        print(f"{name:20} {ours:8.2f} {ours / copy:8.1f} {text}", flush=True)
    print(f"{'sum without psf_blur':20} {sums['others']:8.2f} {sums['others'] / copy:8.1f}")
    if sums["shared, ours"]:
        ours, their = sums["shared, ours"], sums["shared, theirs"]
        print(f"{'sum of those in both':20} {ours:8.2f} {ours / copy:8.1f} {their:17.1f} {their / ours:7.1f}")


_PAIR: Pair | None = None


def _start(pair: Pair, names: list[str]) -> None:
    """Prepare a worker: keep the pair, compile and fill the caches."""
    global _PAIR
    cv2.setNumThreads(1)
    _PAIR = pair
    for name in names:
        _work((name, 3, 0))


def _work(job: tuple[str, int, int]) -> None:
    name, severity, seed = job
    assert _PAIR is not None
    corrupt(*_PAIR, name, severity, seed=seed)


def scaling(names: list[str], pair: Pair, count: int, rounds: int) -> None:
    """Wall time of the same jobs by one worker and by `count`, threads and processes; the best of three each."""
    usable = []
    for name in names:
        try:
            _start(pair, [name])
            usable.append(name)
        except AssetError as error:
            print(f"{name}: left out: {error}")
    jobs = [(name, severity, seed) for seed in range(rounds) for name in usable for severity in SEVERITIES]

    def wall(pool: Executor) -> float:
        start = time.perf_counter()
        list(pool.map(_work, jobs, chunksize=5))
        return time.perf_counter() - start

    def processes(number: int) -> Executor:
        return ProcessPoolExecutor(number, get_context("spawn"), _start, (pair, usable))

    for kind, make in (("threads", ThreadPoolExecutor), ("processes", processes)):
        with make(1) as one, make(count) as many:
            for pool in (one, many):
                wall(pool)
            times = np.min([[wall(one), wall(many)] for _ in range(3)], axis=0)
        print(f"{count} {kind}: {times[0]:.2f} s -> {times[1]:.2f} s, {times[0] / times[1]:.2f} times")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", help="HxW to resize to (375x1242 for the embedded pair, else the images' own)")
    parser.add_argument("--images", nargs=2, type=Path, metavar=("FRAME1", "FRAME2"), help="a pair of real images")
    parser.add_argument("--corruptions", nargs="+", default=[*IMAGE_PAIR, *FURTHER_NAMES], metavar="NAME")
    parser.add_argument("--seconds", type=float, default=1.0, help="time for each corruption (at least 3 rounds)")
    parser.add_argument("--threads", type=int, help="measure scaling to this many threads and processes instead")
    parser.add_argument("--rounds", type=int, default=4, help="with --threads: times every severity is computed")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pair = load_pair(options.images, options.size)
    if options.threads:
        names = [name for name in options.corruptions if name != "psf_blur" and name not in FURTHER["depth"]]
        scaling(names, pair, options.threads, options.rounds)
    else:
        table(options.corruptions, pair, load_depth(options.images, pair[0].shape[:2]), options.seconds)


if __name__ == "__main__":
    main()

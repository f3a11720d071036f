"""Measure the time per pair of each corruption, compared with other packages and the reference code.

    python bench/corruptions.py [--size 375x1242] [--images A.png B.png] [--threads 2]
    python bench/corruptions.py --reference CLONE --reference-python PYTHON

The script measures CPU time with one thread, in milliseconds. In each round, a corruption is drawn and applied to both
frames, and the implementations alternate. Every result is the best time of several rounds, averaged over the five
severities.

Three packages are timed if they are installed. `imagecorruptions-imaug` and albumentations depend on a different OpenCV
package, which would overwrite ours, so install them without their dependencies: `pip install --no-deps
imagecorruptions-imaug albumentations albucore==0.0.24 stringzilla simsimd`. albumentations and kornia (with PyTorch)
get our severity's parameter where they have such a transform. kornia's time includes the conversion of the frames to
tensors and back. The reference code is a
clone of the paper authors' repository; PYTHON is the interpreter of an environment with the (older) packages that the
code needs.

Corruptions that need depth use the embedded pair's depth, resized with the pair. For other images, the depth is that of
a flat road: the ground is 1.65 m below the camera, which moves forward by 1 m.

With `--threads N`, the script instead measures the speed-up of N threads and of N processes over a single one for the
same work.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import importlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from robustflow.core.errors import AssetError
from robustflow.core.types import Camera, SceneDepth
from robustflow.corruptions import corrupt, load_corruption
from robustflow.corruptions.registry import CLIP, FURTHER, IMAGE_PAIR
from robustflow.data.datasets.motorcycle import Motorcycle
from robustflow.media.images import read_image

SEVERITIES = (1, 2, 3, 4, 5)
FURTHER_NAMES = tuple(name for names in FURTHER.values() for name in names if name not in CLIP)
THEIR_NAMES = {"high_light": "brightness", "camera_motion_blur": "motion_blur"}
Pair = tuple[np.ndarray, np.ndarray]


def load_pair(images: list[Path] | None, size: str | None) -> Pair:
    """The given images, or the embedded pair, resized to "HxW"."""
    frames = [read_image(path) for path in images] if images else Motorcycle().load("motorcycle").frames[:2]
    if size or not images:
        height, width = map(int, (size or "375x1242").split("x"))
        frames = [cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in frames]
    return np.ascontiguousarray(frames[0]), np.ascontiguousarray(frames[1])


def load_depth(images: list[Path] | None, shape: tuple[int, int]) -> SceneDepth:
    """Depth of the given images or of the embedded pair, at `shape` (H, W)."""
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


def best_of(jobs: list[Callable[[], float | None]], seconds: float) -> list[float | None]:
    """Return the best time of each job, in milliseconds; the jobs alternate for at least `seconds` and three rounds.

    A job returns its time, or None if it cannot run, in which case it is not called again.
    """
    best = [None if job() is None else float("inf") for job in jobs]  # this call compiles and fills caches
    rounds, end = 0, time.perf_counter() + seconds
    while rounds < 3 or time.perf_counter() < end:
        for i, job in enumerate(jobs):
            if (known := best[i]) is not None and (taken := job()) is not None:
                best[i] = min(known, taken)
        rounds += 1
    return best


def timed(call: Callable[[], Any]) -> Callable[[], float]:
    """Return a job that measures the CPU time of a call, in milliseconds."""

    def job() -> float:
        start = time.process_time()
        call()
        return 1e3 * (time.process_time() - start)

    return job


Transforms = dict[str, Callable[[Any, Any], Any]]
"""Transforms of a package by the name of a corruption: functions of its module and of our severity's parameter."""

_BOX = {"downscale": cv2.INTER_AREA, "upscale": cv2.INTER_NEAREST}
ALBUMENTATIONS: Transforms = {
    "jpeg_compression": lambda a, quality: a.ImageCompression(quality_range=(quality, quality), p=1),
    "pixelate": lambda a, scale: a.Downscale((scale, scale), _BOX, p=1),
    "spatter": lambda a, level: a.Spatter(level.mean, level.deviation, level.sigma, level.threshold, p=1),
    "gaussian_noise": lambda a, deviation: a.GaussNoise((deviation, deviation), p=1),
    "impulse_noise": lambda a, share: a.SaltAndPepper((share, share), p=1),
    "gaussian_blur": lambda a, sigma: a.GaussianBlur((2 * int(4 * sigma + 0.5) + 1,) * 2, (sigma, sigma), p=1),
    "defocus_blur": lambda a, disk: a.Defocus((disk.radius, disk.radius), (disk.smoothing, disk.smoothing), p=1),
    "glass_blur": lambda a, glass: a.GlassBlur(glass.sigma, glass.reach, glass.iterations, p=1),
    "camera_motion_blur": lambda a, shake: a.MotionBlur((2 * shake.radius + 1, 2 * shake.radius + 1), p=1),
}
KORNIA: Transforms = {
    "jpeg_compression": lambda k, quality: k.RandomJPEG((float(quality), float(quality))),
    "contrast": lambda k, factor: k.RandomContrast((factor, factor)),
    "gaussian_noise": lambda k, deviation: k.RandomGaussianNoise(std=deviation, p=1),
    "impulse_noise": lambda k, share: k.RandomSaltAndPepperNoise((share, share), p=1),
    "gaussian_blur": lambda k, sigma: k.RandomGaussianBlur(2 * int(np.ceil(3 * sigma)) + 1, (sigma, sigma), p=1),
    "camera_motion_blur": lambda k, shake: k.RandomMotionBlur(2 * shake.radius + 1, (-45.0, 45.0), 0.0, p=1),
}


def of_imagecorruptions(package: Any, name: str, severity: int) -> Callable[[np.ndarray], Any] | None:
    name = THEIR_NAMES.get(name, name)
    if name not in package.get_corruption_names("all"):
        return None
    return lambda frame: package.corrupt(frame, severity, name)


def of_albumentations(package: Any, name: str, severity: int) -> Callable[[np.ndarray], Any] | None:
    if name not in ALBUMENTATIONS:
        return None
    transform = ALBUMENTATIONS[name](package, load_corruption(name).parameter(severity))
    return lambda frame: transform(image=frame)["image"]


def of_kornia(package: Any, name: str, severity: int) -> Callable[[np.ndarray], Any] | None:
    if name not in KORNIA:
        return None
    import torch

    torch.set_num_threads(1)
    transform = KORNIA[name](package, load_corruption(name).parameter(severity))

    def apply(frame: np.ndarray) -> np.ndarray:
        tensor = torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255
        return transform(tensor)[0].mul(255).round().to(torch.uint8).permute(1, 2, 0).numpy()

    return apply


PACKAGES = {
    "imagecorruptions": ("imagecorruptions", of_imagecorruptions),
    "albumentations": ("albumentations", of_albumentations),
    "kornia": ("kornia.augmentation", of_kornia),
}


class Reference:
    """The reference code in a process of a separate Python interpreter, which measures its own CPU time."""

    def __init__(self, clone: Path, python: str, pair: Pair) -> None:
        self.folder = tempfile.TemporaryDirectory()
        frames = Path(self.folder.name, "pair.npy")
        np.save(frames, np.stack(pair))
        command = [python, str(Path(__file__).resolve().with_name("reference_corruptions.py")), str(frames)]
        self.process = subprocess.Popen(command, cwd=clone, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def milliseconds(self, name: str, severity: int) -> float | None:
        """Time one corruption of the pair; None if the reference code does not have it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{name} {severity}\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline().strip()
        if not answer:
            raise SystemExit("the process of the reference code exited; see its messages above")
        return None if answer == "-" else float(answer)


Rivals = dict[str, Callable[[str, int], float | None]]
"""Other implementations by name: functions that return the milliseconds of a corruption at a severity, or None if it is
missing."""


def rivals(pair: Pair, reference: Reference | None) -> Rivals:
    """Return the alternative implementations that can be measured on this machine."""
    found: Rivals = {}
    for title, (module, transform_of) in PACKAGES.items():
        try:
            package = importlib.import_module(module)
        except ImportError as error:
            print(f"{title} is left out: {error}")
            continue

        def of_package(name: str, severity: int, package: Any = package, of: Any = transform_of) -> float | None:
            transform = of(package, name, severity)
            return None if transform is None else timed(lambda: [transform(frame) for frame in pair])()

        found[title] = of_package
    if reference is not None:
        names = {"high_light": "brightness"}
        found["reference"] = lambda name, severity: reference.milliseconds(names.get(name, name), severity)
    return found


def measure(name: str, pair: Pair, depth: SceneDepth, others: Rivals, seconds: float) -> list[float | None]:
    """Milliseconds per pair, averaged over severities, ours first; None if an implementation lacks the
    corruption.
    """
    rows = []
    for severity in SEVERITIES:
        jobs: list[Callable[[], float | None]] = [timed(partial(corrupt, *pair, name, severity, depth=depth))]
        jobs += [partial(other, name, severity) for other in others.values()]
        rows.append(best_of(jobs, seconds / len(SEVERITIES)))
    columns = zip(*rows, strict=True)
    return [None if None in column else float(np.mean(column)) for column in columns]  # type: ignore[arg-type]


def table(names: list[str], pair: Pair, depth: SceneDepth, others: Rivals, seconds: float) -> None:
    copy = best_of([timed(lambda: [frame.copy() for frame in pair])], 0.2)[0]
    assert copy is not None
    height, width = pair[0].shape[:2]
    print(
        f"ms per pair, {height}x{width}, one thread, mean over severities; copying the pair alone takes {copy:.2f} ms"
    )
    print(f"{'corruption':20} {'ours':>8} {'copies':>8}" + "".join(f" {other:>17} {'ratio':>7}" for other in others))
    everything, shared = 0.0, {other: [0.0, 0.0] for other in others}
    for name in names:
        try:
            ours, *theirs = measure(name, pair, depth, others, seconds)
        except AssetError as error:
            print(f"{name:20} left out: {error}")
            continue
        assert ours is not None
        everything += ours if name != "psf_blur" else 0
        text = ""
        for other, value in zip(others, theirs, strict=True):
            text += f" {'-':>17} {'-':>7}" if value is None else f" {value:17.1f} {value / ours:7.1f}"
            if value is not None:
                shared[other][0] += ours
                shared[other][1] += value
        print(f"{name:20} {ours:8.2f} {ours / copy:8.1f}{text}", flush=True)
    print(f"{'sum without psf_blur':20} {everything:8.2f} {everything / copy:8.1f}")
    for other, (ours, value) in shared.items():
        if ours:
            print(f"shared with {other}: ours {ours:.1f} ms, theirs {value:.1f} ms, {value / ours:.1f} times ours")


_PAIR: Pair | None = None


def _start(pair: Pair, names: list[str]) -> None:
    """Prepare a worker: store the pair, compile functions, and fill caches."""
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
    """Wall time of the same jobs with one worker and with `count` workers, as threads and as processes; each is the
    best of three.
    """
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
        print(f"{count} {kind}: {times[0]:.2f} s -> {times[1]:.2f} s, {times[0] / times[1]:.2f} times faster")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--size",
        help="size HxW to which images are resized (default: 375x1242 for the embedded pair, otherwise unchanged)",
    )
    parser.add_argument("--images", nargs=2, type=Path, metavar=("FRAME1", "FRAME2"), help="a pair of real images")
    parser.add_argument("--corruptions", nargs="+", default=[*IMAGE_PAIR, *FURTHER_NAMES], metavar="NAME")
    parser.add_argument("--seconds", type=float, default=1.0, help="seconds per corruption (at least 3 rounds)")
    parser.add_argument("--threads", type=int, help="measure the scaling to N threads and processes instead")
    parser.add_argument(
        "--rounds", type=int, default=4, help="with --threads: number of times every severity is computed"
    )
    parser.add_argument("--reference", type=Path, metavar="CLONE", help="clone of the paper authors' code")
    parser.add_argument(
        "--reference-python",
        default=sys.executable,
        metavar="PYTHON",
        help="Python interpreter that runs the reference code",
    )
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pair = load_pair(options.images, options.size)
    if options.threads:
        names = [name for name in options.corruptions if name != "psf_blur" and name not in FURTHER["depth"]]
        scaling(names, pair, options.threads, options.rounds)
    else:
        reference = Reference(options.reference, options.reference_python, pair) if options.reference else None
        depth = load_depth(options.images, pair[0].shape[:2])
        table(options.corruptions, pair, depth, rivals(pair, reference), options.seconds)


if __name__ == "__main__":
    main()

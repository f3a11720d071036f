"""Compare the time, memory and error of psf_blur's tiles with those of simple 16-pixel tiles in one run.

    python bench/psf.py [--severity 5] [--rounds 5] [--plain]

For each image size, the script prints the milliseconds for the first image, which include preparing the kernels, the
milliseconds per image afterwards (best of the rounds), the peak additional memory, and the error relative to exact
kernels at 300 pixels. `--plain` adds the method of the reference code, following its description: it is vectorised over
tiles, but uses one kernel and one direct convolution per 16-pixel tile, computes every kernel for every image, and
ignores pixels outside complete tiles. This takes tens of seconds.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import skimage.data
from scipy.ndimage import map_coordinates

from robustflow.corruptions.kernels.cache import BytesCache
from robustflow.corruptions.optics import blur as engine
from robustflow.corruptions.optics.blur import blur
from robustflow.corruptions.optics.psf_field import kernels_at, shipped_field

SIZES = ((375, 1242), (720, 1280))


def photograph(height: int, width: int) -> np.ndarray[Any, Any]:
    """A photograph scaled to the given size."""
    image: np.ndarray[Any, Any] = cv2.resize(skimage.data.astronaut(), (width, height), interpolation=cv2.INTER_AREA)
    return image


def exact(frame: np.ndarray[Any, Any], stack: np.ndarray[Any, Any], x: int, y: int) -> np.ndarray[Any, Any]:
    """A single pixel blurred with its own kernel."""
    height, width = frame.shape[:2]
    padded = np.pad(frame.astype(float), ((30, 30), (30, 30), (0, 0)), mode="reflect")
    kernel = np.empty((1, 3, 61, 61))
    offset = np.array([x - (width - 1) / 2]), np.array([y - (height - 1) / 2])
    kernels_at(stack, *offset, np.hypot(height, width) / 2, kernel)
    around = padded[y : y + 61, x : x + 61][::-1, ::-1].transpose(2, 0, 1)
    return np.asarray((kernel[0] * around).sum((1, 2)))


def plain_tiles(frame: np.ndarray[Any, Any], stack: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Blur with 16-pixel tiles: each tile is convolved directly with a weighted mean of the PSFs of all field points,
    rotated.
    """
    size, reach = 16, 30
    rows, columns = frame.shape[0] // size, frame.shape[1] // size
    padded = np.pad(frame.astype(np.float32), ((reach, reach), (reach, reach), (0, 0)), mode="reflect")
    out = np.zeros(frame.shape, np.float32)
    u, v = np.meshgrid(np.arange(-30.0, 31.0), np.arange(-30.0, 31.0))
    places = np.linspace(0.0, 1.0, len(stack))
    for i in range(rows):
        for j in range(columns):
            dy, dx = i + 0.5 - rows / 2, j + 0.5 - columns / 2
            distance = max(np.hypot(dy, dx), 1e-6)
            weight = np.maximum(np.abs(places - distance / (np.hypot(rows, columns) / 2)), 1e-6) ** -4.0
            mixed = np.tensordot(weight / weight.sum(), stack, 1)
            along, across = (dy * v + dx * u) / distance, (dy * u - dx * v) / distance
            for channel in range(3):
                kernel = map_coordinates(mixed[channel], [along + 30, across + 30], order=1)
                patch = padded[i * size : i * size + size + 60, j * size : j * size + size + 60, channel]
                blurred = cv2.filter2D(patch, -1, (kernel / kernel.sum())[::-1, ::-1], borderType=cv2.BORDER_CONSTANT)
                out[i * size : (i + 1) * size, j * size : (j + 1) * size, channel] = blurred[30:-30, 30:-30]
    return out


class PeakMemory:
    """Peak increase in resident memory since the start, in MB, sampled every 2 ms."""

    def __enter__(self) -> PeakMemory:
        self.start = self.most = self._resident()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self.extra = (self.most - self.start) / 2**20

    @staticmethod
    def _resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    def _watch(self) -> None:
        while not self._done.wait(0.002):
            self.most = max(self.most, self._resident())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--severity", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--plain", action="store_true", help="also time a simple implementation of 16-pixel tiles")
    options = parser.parse_args()
    field = shipped_field(options.severity)
    blur(photograph(64, 64), field)  # compile
    for height, width in SIZES:
        frame = photograph(height, width)
        engine.CACHE = BytesCache(engine.CACHE.limit)
        with PeakMemory() as memory:
            start = time.perf_counter()
            got = blur(frame, field)
            first = time.perf_counter() - start
            rounds, cpu = [], []
            for _ in range(options.rounds):
                start, used = time.perf_counter(), time.process_time()
                blur(frame, field)
                rounds.append(time.perf_counter() - start)
                cpu.append(time.process_time() - used)
        rng = np.random.default_rng(0)
        points = zip(rng.integers(0, width, 300), rng.integers(0, height, 300), strict=True)
        errors = np.array([got[y, x] - exact(frame, field.stack, int(x), int(y)) for x, y in points])
        print(
            f"{height}x{width}: {min(rounds) * 1e3:.0f} ms per image "
            f"({min(cpu) * 1e3:.0f} ms of CPU time), first {first * 1e3:.0f} ms, "
            f"{memory.extra:.0f} MB extra, error {np.sqrt((errors**2).mean()):.3f} rms {np.abs(errors).max():.2f} max"
        )
        if options.plain:
            with PeakMemory() as memory:
                start = time.perf_counter()
                plain_tiles(frame, field.stack)
                seconds = time.perf_counter() - start
            print(f"{height}x{width}, plain 16-pixel tiles: {seconds * 1e3:.0f} ms, {memory.extra:.0f} MB extra")


if __name__ == "__main__":
    main()

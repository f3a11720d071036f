"""Compare the Ray engine with the processes engine: the start-up time, and the throughput of two workers.

    python bench/ray_engine.py

The model sleeps, like a model that waits for a GPU, so that other load on the machine has little influence. The
start-up time is measured in a run of few units, the throughput by the additional time of a run of many units. The
engines alternate, and the best of several repetitions is used.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

import robustflow as rf
from robustflow.images.io import write_image

SLEEP_S = 0.04
WORKERS = 2
FEW, MANY = ("contrast",), ("contrast", "high_light", "over_exposure", "impulse_noise", "gaussian_noise", "pixelate")


def main() -> None:
    """Print both engines' times and the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="rf-bench-"))
    try:
        frames(folder / "frames", options.pairs)
        best: dict[tuple[str, bool], float] = {}
        for _ in range(options.repeat):
            for engine in ("processes", "ray"):
                for many in (False, True):
                    seconds = run(folder, engine, many)
                    best[engine, many] = min(seconds, best.get((engine, many), seconds))
                    print(f"{engine:10} {'many' if many else 'few':5} {seconds:6.1f} s", flush=True)
    finally:
        shutil.rmtree(folder)
    slept = SLEEP_S * (options.pairs * (1 + 5 * len(MANY)) - 2 * (1 + 5 * len(FEW))) / WORKERS
    for engine in ("processes", "ray"):
        print(f"{engine}: {(best[engine, True] - best[engine, False]) / slept:.2f} of the model's time")
    rate = {engine: 1 / (best[engine, True] - best[engine, False]) for engine in ("processes", "ray")}
    print(
        f"start-up time, ray minus processes: {best['ray', False] - best['processes', False]:.1f} s (goal: at most 15)"
    )
    print(f"throughput, ray relative to processes: {rate['ray'] / rate['processes']:.2f} (goal: at least 0.9)")


def sleeping(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A model that predicts zero flow after a delay."""
    time.sleep(SLEEP_S)
    return np.zeros((*frame1.shape[:2], 2), np.float32)


def run(folder: Path, engine: str, many: bool) -> float:
    """Seconds of a run from the call to the last row on disk."""
    start = time.perf_counter()
    rf.evaluate(
        sleeping,
        "folder",
        folder / "frames",
        folder / "run",
        corruptions=MANY if many else FEW,
        limit=None if many else 2,
        engine=engine,
        workers=WORKERS,
        progress=False,
    )
    seconds = time.perf_counter() - start
    shutil.rmtree(folder / "run")
    return seconds


def frames(folder: Path, pairs: int) -> None:
    folder.mkdir()
    draws = np.random.default_rng(0)
    for number in range(pairs + 1):
        coarse = draws.integers(0, 256, (47, 156, 3), np.uint8)
        write_image(
            folder / f"{number:02d}.png", np.ascontiguousarray(coarse.repeat(8, 0)[:375].repeat(8, 1)[:, :1242])
        )


if __name__ == "__main__":
    main()

"""Measure how many flying-shapes pairs one core generates per second during training.

    python bench/shapes.py [--size 160x224] [--pairs 200]

The script measures CPU time and wall time with one thread; the first pairs are left out, because they include
compilation. Every request has a different seed, so that nothing can be cached.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import time

import cv2

from robustflow.data.datasets.shapes.dataset import FlyingShapes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="160x224")
    parser.add_argument("--pairs", type=int, default=200)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    pairs = FlyingShapes(pairs=arguments.pairs + 5, size=arguments.size, seed=time.time_ns() % 2**31, split="train")
    keys = pairs.keys()
    for key in keys[:5]:
        pairs.load(key)
    cpu, wall = time.process_time(), time.perf_counter()
    for key in keys[5:]:
        pairs.load(key)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    count = arguments.pairs
    print(
        f"{count} pairs of {arguments.size}: {count / cpu:.1f} per second of CPU time, "
        f"{count / wall:.1f} per second of wall time"
    )


if __name__ == "__main__":
    main()

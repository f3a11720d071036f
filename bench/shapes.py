"""How many flying-shapes pairs a core makes in a second, as a training asks for them.

    python bench/shapes.py [--size 160x224] [--pairs 200]

One thread, CPU time and wall time; the first pairs, which compile, are left out. Pairs of another seed every time, so
that nothing can be kept.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import time

import cv2

from robustflow.datasets.shapes.dataset import FlyingShapes


def main() -> None:
    """Measure and print."""
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
    print(f"{count} pairs of {arguments.size}: {count / cpu:.1f} a second of CPU time, {count / wall:.1f} of wall time")


if __name__ == "__main__":
    main()

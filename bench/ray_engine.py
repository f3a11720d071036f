"""Compare the Ray engine with the processes engine: start-up time, throughput, and CPU time per cell.

    python bench/ray_engine.py [--pairs 36] [--repeat 3]

The model sleeps for 40 ms, like a model that waits for a GPU; the frames are as large as KITTI's, and the corruptions
are the default ones. The engines alternate, and neighbouring runs are compared. *Steady* is the second half of a run,
when every process has started and compiled its functions. CPU time covers all processes that a run starts, including
Ray's. On a busy machine, compare only the CPU times. Linux only.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

import robustflow as rf
from robustflow.media.images import write_image

SLEEP_S = 0.04
WORKERS = 2


def main() -> None:
    """Print each run's times, and the ratios of the engines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=36, help="pairs of frames; 36 take two minutes on two idle cores")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    ratios: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory(prefix="rf-bench-") as scratch:
        folder = Path(scratch)
        write_frames(folder / "frames", options.pairs)
        for _ in range(options.repeat):
            other, ray = (run(folder, engine) for engine in ("processes", "ray"))
            for name in ray:
                ratios.setdefault(name, []).append(ray[name] / other[name])
    print("ray relative to processes, median and all pairs of runs (goal for the steady wall time: at most 1.05)")
    for name, values in ratios.items():
        print(f"  {name:24} {statistics.median(values):.2f}   {' '.join(f'{value:.2f}' for value in values)}")


class Clock:
    """Records when each unit was written to disk, and the CPU time spent up to that point."""

    def __init__(self) -> None:
        self.begun = time.perf_counter()
        self.done: list[tuple[float, int]] = []
        self.cpu: list[float] = []

    def start(self, folder: Path, total: int, found: int) -> None:
        self.half, self.last = total // 2, total

    def advance(self, done) -> None:
        cells = self.done[-1][1] if self.done else 0
        self.done.append((time.perf_counter() - self.begun, cells + len(done.rows)))
        if len(self.done) in (self.half, self.last):
            self.cpu.append(cpu_seconds())

    def per_cell(self) -> dict[str, float]:
        """Times in ms; those marked "steady" exclude the start-up."""
        (half_s, half), (all_s, cells) = self.done[self.half - 1], self.done[-1]
        return {
            "first row after": 1e3 * self.done[0][0],
            "wall per cell": 1e3 * all_s / cells,
            "wall per cell, steady": 1e3 * (all_s - half_s) / (cells - half),
            "CPU per cell, steady": 1e3 * (self.cpu[1] - self.cpu[0]) / (cells - half),
        }


def sleeping(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A model that predicts zero flow after a delay."""
    time.sleep(SLEEP_S)
    return np.zeros((*frame1.shape[:2], 2), np.float32)


def run(folder: Path, engine: str) -> dict[str, float]:
    """Measure and print one run."""
    clock = Clock()
    rf.evaluate(sleeping, "folder", folder / "frames", folder / "run", engine=engine, workers=WORKERS, progress=clock)
    shutil.rmtree(folder / "run")
    times = clock.per_cell()
    print(f"{engine:10}", "  ".join(f"{name} {value:.1f} ms" for name, value in times.items()), flush=True)
    return times


def cpu_seconds() -> float:
    """CPU seconds of this process and all of its child and descendant processes that are still running."""
    parents, seconds = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # the process has ended
            continue
        process = int(path.parent.name)
        parents[process] = int(fields[1])
        seconds[process] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    mine = {os.getpid()}
    while more := {process for process, parent in parents.items() if parent in mine} - mine:
        mine |= more
    return sum(seconds[process] for process in mine)


def write_frames(folder: Path, pairs: int) -> None:
    """Write generated frames of KITTI's size."""
    folder.mkdir()
    draws = np.random.default_rng(0)
    for number in range(pairs + 1):
        coarse = draws.integers(0, 256, (47, 156, 3), np.uint8)
        frame = coarse.repeat(8, 0)[:375].repeat(8, 1)[:, :1242]
        write_image(folder / f"{number:02d}.png", np.ascontiguousarray(frame))


if __name__ == "__main__":
    main()

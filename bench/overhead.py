"""Measure the overhead of a run beyond the model itself: wall time relative to the model's own time, and CPU time per
cell.

    python bench/overhead.py [--data FOLDER_OF_KITTI_2015] [--pairs 3] [--workers 2] [--latency 40 20]
        [--cells many few] [--no-serial] [--cells-only]

One model sleeps, to imitate a GPU model that leaves the CPU idle, and one computes as long on one thread. The data are
pairs of 375x1242 pixels (from KITTI, or generated textures without --data): `many` cells of a pair are the paper's 20
image-pair corruptions at five severities; `few` are two of them at one severity, on ten times as many pairs, most of
whose time is loading. The ratios are wall time over predictions x latency, or over the wall time of the computing model
(ideally 1): *steady* after the first row is on disk, *with the start* from the beginning. The predictions of `many`
take two minutes for 30 pairs at 40 ms each. The engine with one process (`serial`) is measured first; the other one has
a process that only predicts. A second table lists the CPU time of all work except the model, by stage and corruption,
in one thread; it is the minimum over three runs of every cell.
"""

from __future__ import annotations

import os

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)

import argparse
import resource
import sys
import tempfile
import time
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

# processes that only predict also load this file, so modules that they do not need are imported late
if __name__ == "__main__":
    from robustflow.core.opencv import one_opencv_thread
    from robustflow.corruptions.registry import IMAGE_PAIR
    from robustflow.data.benchmarks import Benchmark
    from robustflow.data.datasets import load_dataset
    from robustflow.metrics.rows import CLEAN
    from robustflow.models import ModelRef
    from robustflow.run.computation import Computation
    from robustflow.run.compute_missing import compute_missing
    from robustflow.run.config import Compute, RunConfig
    from robustflow.run.engines.choose import choose_engine
    from robustflow.run.plan import Job, name_model
    from robustflow.run.setup import set_up
    from robustflow.run.stages import Seconds
    from robustflow.run.store import RunFolder
    from robustflow.testing import TexturePairs

SEVERITIES = (1, 2, 3, 4, 5)
SIZE = (375, 1242)
ROUNDS = 3


FEW = ("fog", "contrast")


class Sleeper:
    """A model that sleeps, which is what a GPU model looks like to the CPU, or computes on one thread."""

    def __init__(self, milliseconds: float = 40.0, device: str = "cuda:0", computes: bool = False) -> None:
        self.device, self._computes = device, computes
        self._seconds = milliseconds / 1e3
        self._flow: np.ndarray | None = None

    def identity(self) -> dict[str, str]:
        return {"name": "sleeper"}

    def predict(self, frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
        start, work = time.perf_counter(), time.thread_time()
        if self._flow is None or self._flow.shape[:2] != frame1.shape[:2]:
            self._flow = np.zeros((*frame1.shape[:2], 2), np.float32)
        while self._computes and time.thread_time() - work < self._seconds:
            np.cumsum(self._flow, axis=1, out=self._flow)
        if not self._computes:
            time.sleep(max(0.0, start + self._seconds - time.perf_counter()))
        return self._flow


class Clock:
    """Records when each unit was written to disk, its number of cells, and the seconds in the model."""

    def __init__(self) -> None:
        self.begun = time.perf_counter()
        self.done: list[tuple[float, int, float]] = []

    def start(self, folder: Path, total: int, found: int) -> None:
        self.begun = time.perf_counter()

    def advance(self, done) -> None:
        self.done.append((time.perf_counter() - self.begun, len(done.rows), done.seconds["predict"]))


def cpu_seconds() -> float:
    """CPU seconds of this process, its finished children, and its running children with theirs: workers are children of
    the process from which they are forked."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    ticks = 0
    for child in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
        ticks += sum(map(int, Path("/proc", child, "stat").read_text().rpartition(")")[2].split()[11:15]))
    return sum(each.ru_utime + each.ru_stime for each in usage) + ticks / os.sysconf("SC_CLK_TCK")


def kitti(folder: Path | None, pairs: int, few: bool = False) -> Benchmark:
    pairs *= 10 if few else 1
    dataset = load_dataset("kitti2015", folder) if folder else TexturePairs(pairs, SIZE)
    corruptions, severities = (FEW, (3,)) if few else (IMAGE_PAIR, SEVERITIES)
    return Benchmark("overhead", dataset, tuple(dataset.keys()[:pairs]), corruptions, severities)


def run(benchmark: Benchmark, milliseconds: float, computes: bool, engine: str, workers: int | None) -> str:
    """Measure one run and format it as a row of the table."""
    model = ModelRef.parse("overhead:Sleeper", (("milliseconds", milliseconds), ("computes", computes)))
    plan = set_up(model, benchmark, RunConfig(compute=Compute(engine=engine, workers=workers)))
    clock = Clock()
    chosen = choose_engine(plan)
    with tempfile.TemporaryDirectory() as scratch:
        folder = RunFolder(Path(scratch) / "run")
        folder.lock()
        before = cpu_seconds()
        compute_missing(folder, plan, chosen, clock)
        spent = cpu_seconds() - before
        folder.unlock()
    ends, rows, predicting = (np.array(each) for each in zip(*clock.done, strict=True))
    of_model = predicting if computes else rows * milliseconds / 1e3
    first, wall = ends[[0, -1]]
    steady = (wall - first) / of_model[1:].sum()
    name = chosen.describe(plan.units())
    return (
        f"{milliseconds:4.0f} ms {'computed' if computes else 'asleep':8}  {name:34}  start {first:5.2f} s  "
        f"steady {steady:5.3f}  with the start {wall / of_model.sum():5.3f}  wall {wall:6.2f} s  "
        f"CPU {1e3 * spent / rows.sum():5.1f} ms per cell"
    )


def cells(benchmark: Benchmark) -> None:
    """Measure the CPU time by stage and corruption for the first pair, and print it as a table."""
    seconds = Seconds(float)
    key = benchmark.keys[0]
    computation = Computation(Job(benchmark.dataset, name_model(Sleeper())), seconds)
    frame_stage = computation.frames

    def best(work) -> float:
        least = float("inf")
        for _ in range(ROUNDS):
            start = time.process_time()
            work()
            least = min(least, time.process_time() - start)
        return 1e3 * least

    loaded = frame_stage.load(key)
    shape = loaded.sample.shape
    rng = np.random.default_rng(0)
    clean, flow = rng.normal(0, 3, (2, *shape, 2)).astype(np.float32)
    loaded.clean = clean
    digest = best(lambda: computation.digest(loaded.sample.frames))
    row = best(lambda: computation.row(loaded, flow, "", (key, CLEAN, 0)))
    per_sample = best(lambda: frame_stage.load(key))
    total = 0.0
    print(f"\nCPU time without the model, {shape[0]}x{shape[1]}, one thread, ms per cell")
    for name in benchmark.corruptions:
        frame_stage.corrupt(loaded.sample, name, 3)  # this call compiles and reads resources
        each = [best(partial(frame_stage.corrupt, loaded.sample, name, severity)) for severity in SEVERITIES]
        total += sum(each)
        print(f"  corrupt  {name:20} {np.mean(each):7.2f}   by severity {' '.join(f'{one:6.1f}' for one in each)}")
    number = len(benchmark.corruptions) * len(SEVERITIES)
    around = total / number + digest + row + per_sample / number
    print(f"  corrupt  mean of {number:3d} cells    {total / number:7.2f}")
    print(f"  digest of the frames          {digest:7.2f}")
    print(f"  measure                       {row:7.2f}")
    print(f"  load, {per_sample:5.1f} ms per sample      {per_sample / number:7.2f}")
    print(f"  all                           {around:7.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--latency", type=float, nargs="+", default=[40.0, 20.0])
    parser.add_argument("--cells", nargs="+", choices=("many", "few"), default=["many", "few"])
    parser.add_argument("--no-serial", action="store_true")
    parser.add_argument("--cells-only", action="store_true")
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).resolve().parent))  # including children
    benchmark = kitti(options.data, options.pairs)
    if not options.cells_only:
        print("wall time over the time of the model")
        engines = [("serial", None)] * (not options.no_serial) + [("processes", options.workers)]
        for cells_of_pair, milliseconds, computes in product(options.cells, options.latency, (False, True)):
            print(f"{cells_of_pair} cells of a pair")
            for engine, workers in engines:
                of_run = kitti(options.data, options.pairs, cells_of_pair == "few")
                print(run(of_run, milliseconds, computes, engine, workers), flush=True)
    with one_opencv_thread():
        cells(benchmark)


if __name__ == "__main__":
    main()

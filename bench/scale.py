"""Measure the overhead of a run of many cells, with the real store and driver loop and a model that takes no time.

    python bench/scale.py [--cells 1000 100000 1000000] [--folder DIR]

A run of the given number of cells (101 per sample: 20 corruptions at 5 severities, and clean) goes through
`runner/compute_missing.py` with an engine that assigns units like the real engines and returns rows immediately: clean
rows are measured on tiny frames, all other rows are generated from a counter. Each step runs in a separate process. The
output contains wall-clock and CPU seconds, the memory before, during and at the peak of the step, and the number of row
files.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from robustflow.core.types import Sample
from robustflow.corruptions.registry import PAPER_ORDER
from robustflow.data.benchmarks.benchmark import Benchmark
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import CLEAN, measure
from robustflow.run.computation import FinishedUnit
from robustflow.run.compute_missing import compute_missing
from robustflow.run.engines.base import Engine, Schedule
from robustflow.run.plan import Job, Unit
from robustflow.run.run import Run
from robustflow.run.setup import set_up
from robustflow.run.stages import frames_digest
from robustflow.run.store import RunFolder, list_shards

CORRUPTIONS = PAPER_ORDER[:20]
STEPS = ("drive", "resume", "resume again", "summary", "show", "report")


class Tiny:
    """Frames of noise, 16x24 pixels, determined by the key."""

    name = "tiny"
    has_flow = True

    def __init__(self, samples: int) -> None:
        self._samples = samples

    def keys(self) -> list[str]:
        return [f"{number:06d}" for number in range(self._samples)]

    def load(self, key: str) -> Sample:
        rng = np.random.default_rng(int(key))
        frames = tuple(rng.integers(0, 256, (16, 24, 3)).astype(np.uint8) for _ in range(2))
        return Sample(key, frames, np.ones((16, 24, 2), np.float32), np.ones((16, 24), bool))

    def files(self, key: str) -> list[Path]:
        return []


def still(frame1: np.ndarray, frame2: np.ndarray) -> np.ndarray:
    """A model that predicts zero flow."""
    return np.zeros((*frame1.shape[:2], 2), np.float32)


def benchmark(cells: int) -> Benchmark:
    """A benchmark with enough samples for about `cells` cells."""
    data = Tiny(max(1, cells // 101))
    return Benchmark("tiny", data, tuple(data.keys()), tuple(CORRUPTIONS))


def answers(job: Job, units: Iterable[Unit]) -> Iterator[FinishedUnit]:
    """An engine whose workers finish instantly."""
    schedule, key, clean = Schedule(units), None, {}
    flow = np.zeros((16, 24, 2), np.float32)
    while (unit := schedule.take(key)) is not None:
        if unit.corruption == CLEAN:
            sample = job.dataset.load(unit.key)
            clean = measure(flow, flow, sample, Regions.of(sample), frames_digest=frames_digest(sample.frames))
        key = unit.key
        schedule.finished(unit)
        yield FinishedUnit(unit, [clean] if unit.corruption == CLEAN else list(synthetic(unit, clean)), {})


def synthetic(unit: Unit, clean: dict[str, object]) -> Iterator[dict[str, object]]:
    """The rows of a unit, determined by its name."""
    for severity in unit.severities:
        more = 1.0 + 0.01 * (CORRUPTIONS.index(unit.corruption) + int(unit.key) % 97) * severity
        yield {**clean, "corruption": unit.corruption, "severity": severity, "rcre_sum": more, "rcre_all_sum": more,
               "epe_sum": float(clean["epe_sum"]) + more,  # type: ignore[arg-type]
               "frames_digest": f"{hash((unit.key, more, severity)) & (1 << 128) - 1:032x}"}  # fmt: skip


def resident() -> float:
    """Current memory of this process, in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@dataclass
class Watch:
    """Memory at the start, at each quarter of the run and at the end."""

    memory: list[float] = field(default_factory=list)

    def start(self, folder: Path, total: int, found: int) -> None:
        self._marks = [found + (total - found) * part // 4 for part in (1, 2, 3, 4)]
        self._done = found
        self.memory.append(resident())

    def advance(self, done: FinishedUnit) -> None:
        self._done += 1
        if self._marks and self._done >= self._marks[0]:
            self._marks.pop(0)
            self.memory.append(resident())


def drive(folder: Path, cells: int) -> list[float]:
    """The finished run without its summary, and the memory use during the run."""
    plan, watch = set_up(still, benchmark(cells)), Watch()
    store = RunFolder(folder)
    store.lock()
    compute_missing(store, plan, Engine(lambda units: "no work", answers), watch)
    store.unlock()
    return watch.memory


def step(name: str, folder: Path, cells: int) -> list[float]:
    """Run one step in this process; return its memory use over time, in MB."""
    from robustflow.api import Result
    from robustflow.cli.tables import print_result

    before = [resident()]
    if name == "drive":
        return before + drive(folder, cells)
    if name.startswith("resume"):
        before += drive(folder, cells)
    elif name == "show":
        Run(folder).write_means()
        Result(folder).write_report()
        print_result(Run(folder))
    elif name == "summary":
        Run(folder).write_means()
    else:
        Result(folder).write_report()
    return [*before, resident()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 100_000])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--step", choices=STEPS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    home = options.folder or Path(tempfile.mkdtemp(prefix="robustflow-bench-"))
    if options.step:
        started = time.perf_counter()
        folder = home / str(options.cells[0])
        memory = step(options.step, folder, options.cells[0])
        usage = resource.getrusage(resource.RUSAGE_SELF)
        wall = time.perf_counter() - started
        files = len(list_shards(folder / "rows"))
        cpu = usage.ru_utime + usage.ru_stime
        over_time = " ".join(f"{each:.0f}" for each in memory)
        print(
            f"{options.cells[0]:>7} {options.step:<13} {wall:7.2f} s wall {cpu:7.2f} s CPU "
            f"peak {usage.ru_maxrss / 1024:5.0f} MB {files:4} files  MB over time: {over_time}",
            file=sys.stderr,
        )
        return
    for cells in options.cells:
        for name in STEPS:
            command = [sys.executable, __file__, "--folder", str(home), "--cells", str(cells), "--step", name]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()

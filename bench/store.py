"""How long a run's folder takes to resume, to show and to average, by its number of rows.

    python bench/store.py [--cells 1000 10000 100000] [--folder DIR]

A run of that many cells (101 a sample: 20 corruptions at 5 severities, and clean) is written through the real store;
its clean rows are measured on tiny frames, the others follow from a counter. Each step runs in a process of its own:
wall-clock and CPU seconds, peak memory, and the number of files of rows.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from robustflow.benchmarks.base import Benchmark
from robustflow.corruptions.registry import PAPER_ORDER
from robustflow.metrics.regions import Regions
from robustflow.metrics.rows import CLEAN, measure
from robustflow.runner.frame_stage import frames_digest
from robustflow.runner.setup import set_up
from robustflow.runs.manifest import now, open_manifest
from robustflow.runs.plan import Unit
from robustflow.runs.run import Run
from robustflow.runs.shards import list_shards
from robustflow.runs.store import RunFolder
from robustflow.sample import Sample

CORRUPTIONS = PAPER_ORDER[:20]
STEPS = ("resume", "resume again", "show", "summary")


class Tiny:
    """Frames of noise, 16 x 24 pixels, that follow from the key."""

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
    """No motion."""
    return np.zeros((*frame1.shape[:2], 2), np.float32)


def benchmark(cells: int) -> Benchmark:
    """As many samples as make about that many cells."""
    data = Tiny(max(1, cells // 101))
    return Benchmark("tiny", data, tuple(data.keys()), tuple(CORRUPTIONS))


def write(folder: Path, cells: int) -> None:
    """The finished run, without its summary."""
    setup = set_up(still, benchmark(cells))
    store = RunFolder(folder)
    store.lock()
    manifest = open_manifest(store, setup.plan)
    flow = np.zeros((16, 24, 2), np.float32)
    units = setup.plan.units()[1 : 1 + len(CORRUPTIONS)]
    for key in setup.plan.benchmark.keys:
        sample = setup.dataset.load(key)
        clean = measure(flow, flow, sample, Regions.of(sample), frames_digest=frames_digest(sample.frames))
        rows = [clean]
        for unit in units:
            for severity in unit.severities:
                more = 1.0 + 0.01 * (len(rows) + int(key) % 97) * severity
                rows.append({**clean, "corruption": unit.corruption, "severity": severity, "rcre_sum": more,
                             "rcre_all_sum": more, "epe_sum": clean["epe_sum"] + more,
                             "frames_digest": f"{hash((key, len(rows))) & (1 << 128) - 1:032x}"})  # fmt: skip
        store.write_rows(Unit(key, CLEAN, (0,)), rows)
        store.finish_sample(key)
    store.pack()
    store.write_manifest({**manifest, "finished": now()})
    store.unlock()


def step(name: str, folder: Path, cells: int) -> None:
    """One step, in this process."""
    from robustflow.api import evaluate
    from robustflow.cli.show import show

    if name.startswith("resume"):
        evaluate(still, benchmark(cells), output=folder)
    elif name == "show":
        show(folder, "all")
    else:
        Run(folder).document()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--step", choices=(*STEPS, "write"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    home = options.folder or Path(tempfile.mkdtemp(prefix="robustflow-bench-"))
    if options.step:
        started = time.perf_counter()
        folder = home / str(options.cells[0])
        (write(folder, options.cells[0]) if options.step == "write" else step(options.step, folder, options.cells[0]))
        usage = resource.getrusage(resource.RUSAGE_SELF)
        wall = time.perf_counter() - started
        files = len(list_shards(folder / "rows"))
        cpu = usage.ru_utime + usage.ru_stime
        print(
            f"{options.cells[0]:>7} {options.step:<13} {wall:7.2f} s wall {cpu:7.2f} s CPU "
            f"{usage.ru_maxrss / 1024:6.0f} MB {files:5} files",
            file=sys.stderr,
        )
        return
    for cells in options.cells:
        for name in ("write", *STEPS):
            command = [sys.executable, __file__, "--folder", str(home), "--cells", str(cells), "--step", name]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()

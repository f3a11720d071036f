"""The benchmarks: which samples, corruptions and severities make a number comparable."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from ..datasets import DATASETS
from ..errors import UsageError, unknown_name
from ..registry import Registry
from .base import Benchmark
from .dataset import from_dataset

__all__ = ["BENCHMARKS", "Benchmark", "load_benchmark"]


class BenchmarkFactory(Protocol):
    """Builds a benchmark from where its data lies."""

    def __call__(self, data: Path | None, split: Path | None) -> Benchmark: ...


BENCHMARKS: Registry[BenchmarkFactory] = Registry("benchmark", entry_point_group="robustflow.benchmarks")
BENCHMARKS.add("demo", "robustflow.benchmarks.demo:demo")
BENCHMARKS.add("kitti-fc", "robustflow.benchmarks.kitti_fc:kitti_fc")
BENCHMARKS.add("gopro-fc", "robustflow.benchmarks.gopro_fc:gopro_fc")


def load_benchmark(
    name: str,
    data: str | Path | None = None,
    split: str | Path | None = None,
    options: dict[str, Any] | None = None,
) -> Benchmark:
    """A benchmark by name.

    Args:
        name: "demo", "kitti-fc", "gopro-fc", or any dataset: "folder" (your own frames or video), "sintel", "hd1k", ...
        data: the folder that holds its samples (for "folder" and "gopro-fc" also a video file); "demo" needs none.
        split: a file naming the samples to evaluate, one key a line; or "drive-disjoint", of KITTI 2015.
        options: of a dataset, for example {"render_pass": "final"} for Sintel.

    Raises:
        UsageError: an unknown name or option, or data missing where it is needed.
        DataError: the folder is not what the benchmark expects.

    >>> load_benchmark("demo").keys
    ('motorcycle',)
    """
    root = Path(data).expanduser() if data is not None else None
    chosen = Path(split).expanduser() if split is not None else None
    if name not in BENCHMARKS.names():
        if name in DATASETS.names():
            return from_dataset(name, root, chosen, options or {})
        raise unknown_name("benchmark", name, [*BENCHMARKS.names(), *DATASETS.names()])
    if options:
        raise UsageError(f"the benchmark {name} takes no data options; leave out {', '.join(options)}")
    return BENCHMARKS.get(name)(root, chosen)

"""The benchmarks: which samples, corruptions and severities make a number comparable."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from ..registry import Registry
from .base import Benchmark

__all__ = ["BENCHMARKS", "Benchmark", "load_benchmark"]


class BenchmarkFactory(Protocol):
    """Builds a benchmark from where its data lies."""

    def __call__(self, data: Path | None, split: Path | None) -> Benchmark: ...


BENCHMARKS: Registry[BenchmarkFactory] = Registry("benchmark", entry_point_group="robustflow.benchmarks")
BENCHMARKS.add("demo", "robustflow.benchmarks.demo:demo")
BENCHMARKS.add("kitti-fc", "robustflow.benchmarks.kitti_fc:kitti_fc")
BENCHMARKS.add("gopro-fc", "robustflow.benchmarks.gopro_fc:gopro_fc")
BENCHMARKS.add("folder", "robustflow.benchmarks.folder:folder")


def load_benchmark(name: str, data: str | Path | None = None, split: str | Path | None = None) -> Benchmark:
    """A benchmark by name.

    Args:
        name: "demo", "kitti-fc", "gopro-fc" or "folder".
        data: the folder that holds its samples (for "folder" and "gopro-fc" also a video file); "demo" needs none.
        split: a file naming the samples to evaluate, one key a line ("kitti-fc").

    Raises:
        UsageError: an unknown name, or data missing where it is needed.
        DataError: the folder is not what the benchmark expects.

    >>> load_benchmark("demo").keys
    ('motorcycle',)
    """
    return BENCHMARKS.get(name)(
        Path(data).expanduser() if data is not None else None,
        Path(split).expanduser() if split is not None else None,
    )

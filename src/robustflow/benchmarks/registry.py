"""Registry of benchmarks by name: look up facts without loading data, or open a benchmark on its data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from ..datasets import DATASETS, dataset_facts
from ..datasets.guess import benchmark_of_folder, different_benchmark
from ..datasets.own_depth import OwnDepth
from ..errors import DataError, UsageError, unknown_name
from ..layout import user_path
from ..registry import Registry
from ..target import is_target
from .base import Benchmark
from .dataset import from_dataset
from .facts import BenchmarkFacts, facts_of_dataset, facts_of_still, is_still, moving_name
from .own import own_benchmark, own_dataset_benchmark


class Definition(Protocol):
    """Definition of a registered benchmark: a class with its facts and a method to open it."""

    facts: BenchmarkFacts

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """Return the benchmark on the data in a folder."""


DEFAULT = "demo"
"""The default benchmark."""

BENCHMARKS: Registry[Definition] = Registry("benchmark", entry_point_group="robustflow.benchmarks")
BENCHMARKS.add("demo", "robustflow.benchmarks.demo:Demo")
BENCHMARKS.add("kitti-fc", "robustflow.benchmarks.kitti_fc:KittiFC")
BENCHMARKS.add("gopro-fc", "robustflow.benchmarks.gopro_fc:GoProFC")


def load_benchmark(
    name: str,
    data: str | Path | None = None,
    split: str | Path | None = None,
    options: dict[str, Any] | None = None,
) -> Benchmark:
    """Open a benchmark by name."""
    others = dict(options or {})
    depth, focal = others.pop("depth", None), others.pop("focal", None)
    return with_own_depth(_load(name, data, split, others), depth, focal)


def with_own_depth(benchmark: Benchmark, folder: str | Path | None, focal: float | None) -> Benchmark:
    """Return a benchmark with the user's depth maps; without a folder, the benchmark itself."""
    if folder is not None:
        return replace(benchmark, own_depth=OwnDepth(folder, benchmark.dataset, focal))
    if focal is not None:
        raise UsageError("--focal only applies to your own depth maps: give --depth DIR as well, or leave it out")
    return benchmark


def _load(name: str, data: str | Path | None, split: str | Path | None, options: dict[str, Any]) -> Benchmark:
    chosen = user_path(split) if split is not None else None
    reserved = [*BENCHMARKS.names(), *DATASETS.names()]
    if data is not None and is_target(str(data)) and not Path(data).exists():
        if name != DEFAULT:
            raise UsageError(f"{data} is a custom dataset; omit --benchmark, or give the folder of {name}")
        return own_dataset_benchmark(str(data), chosen, options, reserved)
    root = user_path(data) if data is not None else None
    if name == DEFAULT and root is not None:
        name = _benchmark_of(root)
    if is_target(name):
        if options:
            raise UsageError(f"the benchmark {name} has no data options; omit {', '.join(options)}")
        return own_benchmark(name, root, chosen, reserved)
    try:
        return _opened(name, root, chosen, options, reserved)
    except DataError as error:
        fitting = different_benchmark(root, name) if root is not None else None
        if fitting is None:
            raise
        raise DataError(f"{error}; this folder looks like the data of --benchmark {fitting}") from error


def _benchmark_of(root: Path) -> str:
    """Choose the benchmark for data given without a benchmark: "folder", unless the data look like a known dataset."""
    if not root.exists():
        raise DataError(f"{root}: no such file or folder; check the path")
    if (fitting := benchmark_of_folder(root)) is not None:
        raise UsageError(
            f"{root} looks like the data of {fitting}: give --benchmark {fitting} or another that reads it "
            "(see robustflow list datasets)"
        )
    return "folder"


def _opened(
    name: str, root: Path | None, split: Path | None, options: dict[str, Any], reserved: list[str]
) -> Benchmark:
    if name not in BENCHMARKS.names():
        if name in DATASETS:
            return from_dataset(name, root, split, options)
        raise unknown_name("benchmark", name, reserved)
    if options:
        raise UsageError(f"the benchmark {name} has no data options; omit {', '.join(options)}")
    return BENCHMARKS.get(name).open(root, split)


def benchmark_facts(name: str) -> BenchmarkFacts:
    """Return the facts of a benchmark by its name, for code that reads manifests and tables without the data."""
    if is_still(name):
        return facts_of_still(benchmark_facts(moving_name(name)))
    if name in BENCHMARKS.names():
        facts = getattr(BENCHMARKS.get(name), "facts", None)
        if isinstance(facts, BenchmarkFacts):
            return facts
    elif name in DATASETS:
        return facts_of_dataset(dataset_facts(name))
    return BenchmarkFacts(title=name[:80] or "unnamed")

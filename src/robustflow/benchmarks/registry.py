"""Every benchmark by name: its facts at no cost, or opened on the data it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from ..datasets import DATASETS, dataset_facts
from ..errors import UsageError, unknown_name
from ..registry import Registry
from .base import Benchmark
from .dataset import from_dataset
from .facts import BenchmarkFacts, facts_of_dataset


class Definition(Protocol):
    """A registered benchmark: a class that states its facts, and opens it.

    Attributes:
        facts: title, ground truth, what the paper measured; nothing is opened to read them.
    """

    facts: BenchmarkFacts

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """The benchmark on the data that lies in a folder.

        Args:
            data: what `--data` names; None where nothing was given.
            split: a file that names the samples to evaluate; None for the benchmark's own choice.

        Raises:
            UsageError: data or a split missing, or given where there is none.
            DataError: the folder is not what the benchmark expects.
        """


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
    """A benchmark by name.

    Args:
        name: "demo", "kitti-fc", "gopro-fc", or any data set: "folder" (your own frames or video), "sintel", ...
        data: the folder that holds its samples (for "folder" and "gopro-fc" also a video file); "demo" needs none.
        split: a file naming the samples to evaluate, one key a line; or "drive-disjoint", of KITTI 2015.
        options: of a data set, for example {"render_pass": "final"} for Sintel.

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
    return BENCHMARKS.get(name).open(root, chosen)


def benchmark_facts(name: str) -> BenchmarkFacts:
    """What is known of a benchmark by its name alone, for those who read manifests and tables and have no data.

    A data set's name gives its own title. A name that nobody registered, as manifests of other machines may hold,
    gives neutral facts: its name as the title, and nothing from the paper; no code is loaded for it.

    >>> facts = benchmark_facts("kitti-fc")
    >>> facts.title, facts.paper_pairs, len(facts.paper_corruptions), facts.training_set
    ('KITTI-FC', 80, 20, 'kitti2015')
    >>> benchmark_facts("gopro-fc").has_flow, benchmark_facts("sintel").title
    (False, 'MPI-Sintel')
    >>> benchmark_facts("someone:Else")
    BenchmarkFacts(title='someone:Else', description='', data='', has_flow=True, published=False, ...)
    """
    if name in BENCHMARKS.names():
        facts = getattr(BENCHMARKS.get(name), "facts", None)
        if isinstance(facts, BenchmarkFacts):
            return facts
    elif name in DATASETS.names():
        return facts_of_dataset(dataset_facts(name))
    return BenchmarkFacts(title=name[:80] or "unnamed")

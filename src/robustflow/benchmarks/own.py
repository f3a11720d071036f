"""Open a user-defined benchmark, `--benchmark mypkg:MyBench`, or a user-defined dataset as a benchmark."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..corruptions import IMAGE_PAIR
from ..datasets.facts import facts_of
from ..datasets.own import check_members, open_own_dataset, own_source
from ..datasets.split import read_split
from ..errors import UsageError
from ..target import called, import_target
from .base import Benchmark
from .facts import facts_of_dataset


def own_benchmark(target: str, data: Path | None, split: Path | None, reserved: list[str]) -> Benchmark:
    """Open the benchmark that a user specifies as `module.path:Attribute`."""
    made = import_target(target, "benchmark")
    if not isinstance(made, Benchmark):
        opener = made if inspect.isroutine(made) else getattr(made, "open", None)
        if opener is None:
            raise UsageError(f"{target} is not a benchmark: it has no function open; see the guide 'add your dataset'")
        if inspect.isclass(made) and not isinstance(inspect.getattr_static(made, "open"), staticmethod | classmethod):
            opener = called(f"{target} failed in its construction", made).open
        made = called(f"{target} failed in open(data, split)", lambda: opener(data, split))
    if not isinstance(made, Benchmark):
        raise UsageError(f"{target} returned {type(made).__name__}; open must return a Benchmark")
    if made.name in reserved:
        raise UsageError(f"{target} has the name of the benchmark '{made.name}': give it a different name")
    check_members(made.dataset, f"the dataset of {target}")
    check_keys(made, target)
    source = {"benchmark": target, "source": own_source(target, made.dataset)}
    return replace(made, protocol={**made.protocol, "own": source})


def check_keys(benchmark: Benchmark, what: str) -> None:
    """Check that a user's benchmark lists samples, and only samples of its dataset."""
    if not benchmark.keys:
        raise UsageError(f"{what} lists no samples: keys must contain at least one key of its dataset")
    known = set(called(f"the dataset of {what} failed in keys", benchmark.dataset.keys))
    for key in benchmark.keys:
        if key not in known:
            raise UsageError(f"{what} lists the sample {key!r:.60}, which its dataset does not contain")


def own_dataset_benchmark(target: str, split: Path | None, options: dict[str, Any], reserved: list[str]) -> Benchmark:
    """Return a benchmark with every sample of a user's dataset under every image-pair corruption."""
    dataset = open_own_dataset(target, options)
    if dataset.name in reserved:
        raise UsageError(f"{target} has the name of the dataset '{dataset.name}': give it a different name")
    keys = read_split(split, dataset.keys()) if split else dataset.keys()
    protocol: dict[str, Any] = {"own": {"dataset": target, "source": own_source(target, dataset)}}
    if options:
        protocol["options"] = {key: str(value) for key, value in sorted(options.items())}
    facts = facts_of_dataset(facts_of(dataset, dataset.name))
    return Benchmark(dataset.name, dataset, tuple(keys), IMAGE_PAIR, protocol=protocol, facts=facts)

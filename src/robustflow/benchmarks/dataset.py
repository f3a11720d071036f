"""Any data set as a benchmark: the user's own frames (`folder`), or Sintel, HD1K, Spring and the others by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..corruptions import IMAGE_PAIR
from ..datasets import PreCorrupted, dataset_facts, load_dataset
from ..datasets.split import selected
from ..errors import UsageError
from .base import Benchmark
from .facts import facts_of_dataset


def from_dataset(name: str, data: Path | None, split: Path | None, options: dict[str, Any]) -> Benchmark:
    """Every sample of a data set under every image-pair corruption. Without ground truth, only RCRE is measured.

    Raises:
        UsageError: a data set that is a benchmark of its own, an unknown option, or a missing root.
        DataError: the folder does not have the data set's layout.
    """
    dataset, facts = load_dataset(name, data, **options), dataset_facts(name)
    if isinstance(dataset, PreCorrupted):
        instead = f": use --benchmark {facts.benchmark}" if facts.benchmark else ""
        raise UsageError(f"the frames of '{name}' are corrupted already{instead}")
    keys = selected(split, dataset.keys(), name) if split else dataset.keys()
    protocol = {"options": {key: str(value) for key, value in sorted(options.items())}} if options else {}
    return Benchmark(name, dataset, tuple(keys), IMAGE_PAIR, protocol=protocol, facts=facts_of_dataset(facts))

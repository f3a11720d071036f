"""Use any dataset as a benchmark: the user's own frames (`folder`), or a registered dataset such as Sintel, HD1K or
Spring."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from ..corruptions import IMAGE_PAIR
from ..datasets import PreCorrupted, dataset_facts, load_dataset
from ..datasets.split import selected
from ..errors import DataError, UsageError
from .base import Benchmark
from .facts import NON_OCCLUDED, facts_of_dataset, truth_remark


def from_dataset(name: str, data: Path | None, split: Path | None, options: dict[str, Any]) -> Benchmark:
    """Return a benchmark with every sample of a dataset under every image-pair corruption, or under the corruptions
    distributed with the frames. Without ground truth, only RCRE is computed.
    """
    dataset, facts = load_dataset(name, data, **options), dataset_facts(name)
    if isinstance(dataset, PreCorrupted) and not facts.corruptions:
        instead = f": use --benchmark {facts.benchmark}" if facts.benchmark else ""
        raise UsageError(f"the frames of '{name}' are corrupted already{instead}")
    keys = selected(split, dataset.keys(), name) if split else dataset.keys()
    deciding = {key: str(value) for key, value in sorted(options.items()) if key not in facts.folder_options}
    protocol: dict[str, Any] = {"options": deciding} if deciding else {}
    if getattr(dataset, "non_occluded", False):
        protocol |= NON_OCCLUDED
        warnings.warn(
            f"{data}: no flow_occ/, so errors are measured on {truth_remark(protocol)} (flow_noc/), which is easier "
            f"than {facts.title}'s usual ground truth; unpack flow_occ/ there to use it",
            stacklevel=5,
        )
    about = facts_of_dataset(facts)
    if not isinstance(dataset, PreCorrupted):
        return Benchmark(name, dataset, tuple(keys), IMAGE_PAIR, protocol=protocol, facts=about)
    there = tuple(corruption for corruption in facts.corruptions if dataset.has_corrupted(corruption))
    if not there:
        raise DataError(f"{data}: has clean frames of {facts.title} but no corrupted ones; expected {facts.layout}")
    protocol["frames"] = "released"
    return Benchmark(name, dataset, tuple(keys), there, about.severities, protocol=protocol, closed=True, facts=about)

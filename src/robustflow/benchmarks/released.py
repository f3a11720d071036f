"""A released benchmark, read from disk."""

from __future__ import annotations

from ..corruptions import PAPER_ORDER, SEVERITIES
from ..datasets.released import ReleasedPairs
from ..errors import DataError
from .base import Benchmark
from .facts import BenchmarkFacts


def released(name: str, dataset: ReleasedPairs, keys: list[str], facts: BenchmarkFacts) -> Benchmark:
    """Return a benchmark with only the corruptions and severities in the folder; no corruption is computed on the
    fly."""
    by_corruption = {corruption: dataset.severities(corruption) for corruption in PAPER_ORDER}
    by_corruption = {corruption: levels for corruption, levels in by_corruption.items() if levels}
    severities = tuple(level for level in SEVERITIES if all(level in levels for levels in by_corruption.values()))
    if not by_corruption or not severities:
        raise DataError(
            f"{dataset.root}: contains clean frames, but no severity that all corruptions share; expected folders "
            "such as fog_3 next to clean"
        )
    protocol = {"frames": "released"}
    return Benchmark(
        name, dataset, tuple(keys), tuple(by_corruption), severities, protocol=protocol, closed=True, facts=facts
    )

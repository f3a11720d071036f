"""`demo`: one real pair with ground truth, included in the installation, under the corruptions of KITTI-FC."""

from __future__ import annotations

from pathlib import Path

from ...core.errors import UsageError
from ...corruptions import IMAGE_PAIR
from ...corruptions.weather.frost import GeneratedFrost
from ..datasets import load_dataset
from .base import Benchmark
from .facts import BenchmarkFacts

DEMO_CLASSES = {"frost": GeneratedFrost}
"""Corruptions that are replaced on the demo pair to avoid a download."""


class Demo:
    """A benchmark of the Middlebury 2014 motorcycle pair (741 x 500); its ground truth is disparity, so all motion is
    horizontal.
    """

    facts = BenchmarkFacts(
        title="demo",
        description="One real pair with ground truth that comes with the installation.",
        training_set="middlebury",
    )

    @staticmethod
    def open(data: Path | None, split: Path | None) -> Benchmark:
        """See `Definition.open`."""
        if data is not None or split is not None:
            raise UsageError("the demo benchmark has its own pair: omit --split, or give --data and --benchmark")
        dataset = load_dataset("motorcycle", None)
        return Benchmark("demo", dataset, tuple(dataset.keys()), IMAGE_PAIR, classes=DEMO_CLASSES, facts=Demo.facts)

"""Shell completion for names of models, corruptions, benchmarks and datasets."""

from collections.abc import Iterable


def models(incomplete: str) -> list[str]:
    """Complete names of models.

    >>> models("farn")
    ['farneback']
    """
    from ..models import MODELS

    return _starting_with(MODELS.names(), incomplete)


def checkpoints(incomplete: str) -> list[str]:
    """Complete names of published checkpoints of any model, and "random"."""
    from ..models.catalog import checkpoints as catalogue

    return _starting_with(("random", *(entry.checkpoint for entry in catalogue())), incomplete)


def corruptions(incomplete: str) -> list[str]:
    """Complete the name of a corruption after the last comma or plus.

    >>> corruptions("fog,fro")
    ['fog,frost']
    """
    from ..corruptions import CORRUPTIONS

    cut = max(incomplete.rfind(","), incomplete.rfind("+")) + 1
    return [incomplete[:cut] + name for name in _starting_with(CORRUPTIONS.names(), incomplete[cut:])]


def benchmarks(incomplete: str) -> list[str]:
    """Complete names of benchmarks, and of datasets, which can be used as benchmarks."""
    from ..benchmarks import BENCHMARKS
    from ..datasets import DATASETS

    return _starting_with((*BENCHMARKS.names(), *DATASETS.names()), incomplete)


KINDS = ("models", "corruptions", "attacks", "benchmarks", "datasets", "recipes")
"""Categories of `list`."""


def kinds(incomplete: str) -> list[str]:
    """Complete the categories of `list`, and "all"."""
    return _starting_with((*KINDS, "all"), incomplete)


def methods(incomplete: str) -> list[str]:
    """Complete names of methods with a training recipe."""
    from ..training.recipe import trained_methods

    return _starting_with(trained_methods(), incomplete)


def tables(incomplete: str) -> list[str]:
    """Complete the name of a `report` table after the last comma."""
    from ..report.assemble import ALL_TABLES, ROW

    cut = incomplete.rfind(",") + 1
    return [incomplete[:cut] + name for name in _starting_with((*ALL_TABLES, ROW), incomplete[cut:])]


def _starting_with(names: Iterable[str], incomplete: str) -> list[str]:
    return list(dict.fromkeys(name for name in names if name.startswith(incomplete)))

"""Shell completion for names of models, corruptions, benchmarks and datasets."""

from collections.abc import Iterable


def models(incomplete: str) -> list[str]:
    """Complete names of models.

    >>> models("farn")
    ['farneback']
    """
    from ..models import MODELS

    return _with_prefix(MODELS.names(), incomplete)


def checkpoints(incomplete: str) -> list[str]:
    """Complete names of published checkpoints of any model, and "random"."""
    from ..models.catalog import checkpoints as catalogue

    return _with_prefix(("random", *(entry.checkpoint for entry in catalogue())), incomplete)


def corruptions(incomplete: str) -> list[str]:
    """Complete the name of a corruption after the last comma or plus.

    >>> corruptions("fog,fro")
    ['fog,frost']
    """
    from ..corruptions import CORRUPTIONS

    cut = max(incomplete.rfind(","), incomplete.rfind("+")) + 1
    return [incomplete[:cut] + name for name in _with_prefix(CORRUPTIONS.names(), incomplete[cut:])]


def benchmarks(incomplete: str) -> list[str]:
    """Complete names of benchmarks, and of datasets, which can be used as benchmarks."""
    from ..benchmarks import BENCHMARKS
    from ..datasets import DATASETS

    return _with_prefix((*BENCHMARKS.names(), *DATASETS.names()), incomplete)


KINDS = ("models", "corruptions", "attacks", "benchmarks", "datasets", "recipes")
"""Categories of `list`."""


def kinds(incomplete: str) -> list[str]:
    """Complete the categories of `list`, and "all"."""
    return _with_prefix((*KINDS, "all"), incomplete)


def methods(incomplete: str) -> list[str]:
    """Complete names of methods with a training recipe."""
    from ..training.recipe import trained_methods

    return _with_prefix(trained_methods(), incomplete)


def tables(incomplete: str) -> list[str]:
    """Complete the name of a `report` table after the last comma."""
    from ..report.assemble import ALL_TABLES, ROW

    cut = incomplete.rfind(",") + 1
    return [incomplete[:cut] + name for name in _with_prefix((*ALL_TABLES, ROW), incomplete[cut:])]


def _with_prefix(names: Iterable[str], incomplete: str) -> list[str]:
    return list(dict.fromkeys(name for name in names if name.startswith(incomplete)))

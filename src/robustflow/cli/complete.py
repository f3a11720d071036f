"""Shell completion of names; what has the names is only imported when a shell asks for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

KINDS = ("models", "corruptions", "attacks", "benchmarks", "datasets", "recipes")
"""Categories of `list`."""


def _completion(names: Callable[[], Iterable[str]], separators: str = "") -> Callable[[str], list[str]]:
    """Return a function that completes the name after the last of the separators."""

    def completion(incomplete: str) -> list[str]:
        cut = max((incomplete.rfind(separator) for separator in separators), default=-1) + 1
        matching = dict.fromkeys(name for name in names() if name.startswith(incomplete[cut:]))
        return [incomplete[:cut] + name for name in matching]

    return completion


def _module(name: str) -> Any:
    return import_module(f"robustflow.{name}")


def _benchmarks() -> Iterable[str]:
    """Return names of benchmarks, and of datasets, which can be used as benchmarks."""
    return *_module("data.benchmarks").BENCHMARKS.names(), *_module("data.datasets").DATASETS.names()


def _checkpoints() -> Iterable[str]:
    return "random", *(entry.checkpoint for entry in _module("models.catalog").checkpoints())


models = _completion(lambda: _module("models").MODELS.names())
checkpoints = _completion(_checkpoints)
corruptions = _completion(lambda: _module("corruptions").CORRUPTIONS.names(), ",+")
benchmarks = _completion(_benchmarks)
kinds = _completion(lambda: (*KINDS, "all"))
methods = _completion(lambda: _module("training.recipe").trained_methods())
tables = _completion(lambda: _module("report.tables").TABLES, ",")

"""A user's dataset `module.path:Attribute`, checked and identified by its source."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

from ...core.errors import UsageError
from ...core.files import digest_of_bytes
from ...core.plugins import called, check_options, import_target, source_of_target
from ...core.source_digest import source_digest
from ...core.types import Sample
from .dataset import Dataset

_GUIDE = "see the guide 'add your dataset'"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")


def open_own_dataset(target: str, options: dict[str, Any]) -> Dataset:
    dataset = import_target(target, "dataset")
    if inspect.isclass(dataset) or inspect.isroutine(dataset):
        check_options(dataset, target, options, "-D")
        opener = dataset
        dataset = called(target, "its constructor", lambda: opener(**options))
    elif options:
        raise UsageError(target, f"a dataset object does not accept options; omit {', '.join(options)}")
    check_members(dataset, target)
    return dataset


def check_members(dataset: Any, what: str) -> None:
    for member in ("name", "has_flow", "keys", "load", "files"):
        if not hasattr(dataset, member):
            raise UsageError(what, f"not a dataset: it has no '{member}'; {_GUIDE}")
    if not isinstance(dataset.name, str) or not _NAME.fullmatch(dataset.name):
        raise UsageError(what, f"the name {dataset.name!r} is invalid: use only letters, digits, '_' and '-'")
    keys = called(what, "keys()", dataset.keys)
    if not isinstance(keys, list) or not keys or not all(isinstance(key, str) and key for key in keys):
        raise UsageError(what, f"keys() must return a non-empty list of strings, not {keys!r:.60}")
    if len(set(keys)) != len(keys):
        raise UsageError(what, f"keys() returns '{next(k for k in keys if keys.count(k) > 1)}' twice")
    check_sample(dataset, keys[0], what)


def load_checked(dataset: Any, key: str, what: str = "") -> Sample:
    what = what or f"the dataset '{dataset.name}'"
    sample = called(what, f"load('{key}')", lambda: dataset.load(key))
    if not isinstance(sample, Sample):
        raise UsageError(what, f"load('{key}') returned {type(sample).__name__}; it must return a Sample")
    if sample.key != key:
        raise UsageError(what, f"load('{key}') returned the sample '{sample.key}'")
    if (sample.flow is not None) != bool(dataset.has_flow):
        state = "has ground truth" if sample.flow is not None else "has no ground truth"
        raise UsageError(what, f"has_flow is {dataset.has_flow}, but sample '{key}' {state}")
    return sample


def check_sample(dataset: Any, key: str, what: str) -> Sample:
    sample = load_checked(dataset, key, what)
    files = called(what, f"files('{key}')", lambda: dataset.files(key))
    if not isinstance(files, list) or not all(isinstance(path, Path) and path.is_file() for path in files):
        raise UsageError(what, f"files('{key}') must return the paths of existing files, not {files!r:.80}")
    return sample


def own_source(target: str, made: object) -> str:
    """Return a hash (16 hexadecimal digits) of the source of a user's object: its class, and the target's module."""
    return digest_of_bytes(source_digest(type(made)).encode(), source_of_target(target) or b"", size=8)

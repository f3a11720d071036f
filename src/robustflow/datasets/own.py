"""Open a user-defined dataset, `module.path:Attribute`, check it, and identify it by the hash of its source."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

from ..digest import digest_of_bytes
from ..errors import UsageError
from ..sample import Sample
from ..source_digest import source_digest
from ..target import called, check_options, import_target, source_of_target
from .base import Dataset

_GUIDE = "see the guide 'add your dataset'"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")


def open_own_dataset(target: str, options: dict[str, Any]) -> Dataset:
    """Open the dataset that a user names as `module.path:Attribute`, and check its first sample."""
    dataset = import_target(target, "dataset")
    if inspect.isclass(dataset) or inspect.isroutine(dataset):
        check_options(dataset, target, options, "-D")
        opener = dataset
        dataset = called(f"{target} failed in its construction", lambda: opener(**options))
    elif options:
        raise UsageError(f"{target} is a dataset object, which does not accept options; omit {', '.join(options)}")
    check_members(dataset, target)
    return dataset


def check_members(dataset: Any, what: str) -> None:
    """Raise if an object is not a valid `Dataset`: check its members, keys, and first sample."""
    for member in ("name", "has_flow", "keys", "load", "files"):
        if not hasattr(dataset, member):
            raise UsageError(f"{what} has no '{member}', so it is not a dataset; {_GUIDE}")
    if not isinstance(dataset.name, str) or not _NAME.fullmatch(dataset.name):
        raise UsageError(f"{what}: the name {dataset.name!r} is invalid: use only letters, digits, '_' and '-'")
    keys = called(f"{what} failed in keys", dataset.keys)
    if not isinstance(keys, list) or not keys or not all(isinstance(key, str) and key for key in keys):
        raise UsageError(f"{what}: keys() must return a non-empty list of strings, not {keys!r:.60}")
    if len(set(keys)) != len(keys):
        raise UsageError(f"{what}: keys() returns '{next(k for k in keys if keys.count(k) > 1)}' twice")
    check_sample(dataset, keys[0], what)


def load_checked(dataset: Any, key: str, what: str = "") -> Sample:
    """Load one sample and check it against the dataset's declarations."""
    what = what or f"the dataset '{dataset.name}'"
    sample = called(f"{what} failed in load('{key}')", lambda: dataset.load(key))
    if not isinstance(sample, Sample):
        raise UsageError(f"{what}: load('{key}') returned {type(sample).__name__}; it must return a Sample")
    if sample.key != key:
        raise UsageError(f"{what}: load('{key}') returned the sample '{sample.key}'")
    if (sample.flow is not None) != bool(dataset.has_flow):
        state = "has ground truth" if sample.flow is not None else "has no ground truth"
        raise UsageError(f"{what}: has_flow is {dataset.has_flow}, but sample '{key}' {state}")
    return sample


def check_sample(dataset: Any, key: str, what: str) -> Sample:
    """Load one sample, see `load_checked`, and check its files."""
    sample = load_checked(dataset, key, what)
    files = called(f"{what} failed in files('{key}')", lambda: dataset.files(key))
    if not isinstance(files, list) or not all(isinstance(path, Path) and path.is_file() for path in files):
        raise UsageError(f"{what}: files('{key}') must return the paths of existing files, not {files!r:.80}")
    return sample


def own_source(target: str, made: object) -> str:
    """Return a hash (16 hexadecimal digits) of the source code of a user's object: its class, and the module named
    in the target."""
    return digest_of_bytes(source_digest(type(made)).encode(), source_of_target(target) or b"", size=8)

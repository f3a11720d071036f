"""Check a data set of your own before a benchmark runs on it."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np

from ..datasets.own import check_members, check_sample
from ..errors import RobustFlowError, UsageError
from ..sample import Sample


def check_dataset(dataset: Any, samples: int = 3) -> str:
    """Try a data set, and return its name.

    It has a name, keys that are the same when asked twice, samples that are what it says (frames RGB uint8 of one size,
    flow float32 with a valid mask where `has_flow`, the same bytes when read twice and after being sent to another
    process), files that are there, and an error for a key that does not exist.

    Args:
        dataset: an object with the members of `robustflow.datasets.Dataset`; see docs/add-your-dataset.md.
        samples: how many to read, spread over the keys.

    Raises:
        UsageError: what is wrong.

    >>> from robustflow.datasets import load_dataset
    >>> check_dataset(load_dataset("motorcycle"))
    'motorcycle'
    """
    what = f"the data set {type(dataset).__name__}"
    check_members(dataset, what)
    keys = dataset.keys()
    _require(dataset.keys() == keys, f"{what}: keys() returns something else the second time")
    try:
        copy = pickle.loads(pickle.dumps(dataset))
    except Exception as error:
        raise UsageError(f"{what} cannot be sent to a worker process ({type(error).__name__}: {error})") from error
    _require(copy.keys() == keys, f"{what}: a pickled copy has other keys")
    places = np.linspace(0, len(keys) - 1, max(1, min(samples, len(keys)))).astype(int)
    for key in dict.fromkeys(keys[place] for place in places):
        first, again = check_sample(dataset, key, what), check_sample(copy, key, what)
        _require(_equal(first, again), f"{what}: sample '{key}' differs when it is read again")
        _require(
            first.flow is None or (first.flow.dtype == np.float32 and bool(np.isfinite(first.flow).all())),
            f"{what}: the flow of '{key}' must be float32 and finite; mark what is unknown in the valid mask",
        )
        _require(first.valid is None or bool(first.valid.any()), f"{what}: '{key}' has no pixel with known flow")
    try:
        dataset.load("no such key")
    except (RobustFlowError, LookupError):
        return str(dataset.name)
    except Exception as error:
        raise UsageError(f"{what}: an unknown key ends in {type(error).__name__}; raise a KeyError") from error
    raise UsageError(f"{what} returns a sample for a key that does not exist; raise a KeyError")


def _equal(one: Sample, other: Sample) -> bool:
    pairs = [*zip(one.frames, other.frames, strict=False), (one.flow, other.flow), (one.valid, other.valid)]
    same = all((a is None and b is None) or np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)
    return same and len(one.frames) == len(other.frames) and one.group == other.group


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise UsageError(message)

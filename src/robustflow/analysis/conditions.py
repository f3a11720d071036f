"""The conditions of runs apart from their model, and how they differ, in words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ..digest import digest_of_value
from ..runs.run import Run

_NOT_CONDITIONS = ("model", "window", "version", "rows")


def conditions_of(runs: Sequence[Run]) -> list[str]:
    """A name for each run's conditions, made from what differs among them; "" for all if nothing does.

    Conditions are the parts of the identity apart from the model (benchmark, seed, variant, severity scale, ...) and
    the samples.
    """
    parts = [_parts(run) for run in runs]
    names = list(dict.fromkeys(name for one in parts for name in one))
    differing = [name for name in names if len({_text(one.get(name)) for one in parts}) > 1]
    return [", ".join(f"{name} {_text(one.get(name))}" for name in differing) for one in parts]


def same_model(runs: Sequence[Run]) -> bool:
    """Whether all runs are of one model."""
    return len({json.dumps(run.manifest["identity"]["model"], sort_keys=True, default=str) for run in runs}) == 1


def _parts(run: Run) -> dict[str, Any]:
    identity = run.manifest["identity"]
    samples = sorted(run.manifest["samples"])
    split = f"{len(samples)} pairs {digest_of_value(samples)[:6]}"
    return {name: value for name, value in identity.items() if name not in _NOT_CONDITIONS} | {"split": split}


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, default=str)

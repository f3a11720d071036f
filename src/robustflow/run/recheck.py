"""Check that rows were measured on frames that others can reproduce, by measuring some of them again.

A row contains a digest of the frames that the model received. Frames depend only on the data, the corruption, its
severity, the seed and the sample's key, so anyone with the data can recompute them without the model.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RunError, UsageError
from ..core.rng import Rng
from ..core.text import plain
from ..metrics.rows import CLEAN
from ..models import ModelRef
from ..models.calls import describe_cell
from .config import MeasuringOptions
from .identity import Identity
from .plan import NO_MODEL, Unit, name_model
from .setup import recorded_plan
from .trust import row_difference
from .worker import temporary_worker

TOLERANCE_PX = 0.01
"""Tolerance for the means of one row, because rounding depends on the processor and the library."""


def recheck(
    identity: Identity,
    rows: pl.DataFrame,
    data: str | Path | None = None,
    *,
    model: ModelRef | None = None,
    options: dict[str, Any] | None = None,
    count: int = 20,
    seed: int | None = None,
) -> str:
    """Measure some rows of a run again, and compare frames, ground truth and, with a model, mean errors. The model must
    be the one that the run names; versions of libraries and the device may differ."""
    if count < 1:
        raise UsageError("--check-frames", f"the number of rows to check must be at least 1; got {count}")
    seed = int.from_bytes(os.urandom(4)) if seed is None else seed
    named, corruptions = NO_MODEL if model is None else name_model(model), set(rows["corruption"]) - {CLEAN}
    plan = recorded_plan(identity, sorted(corruptions), data, options or {}, named)
    if model is not None:
        here, recorded = plan.identity.model.settings, identity.model.settings
        for key in ("name", "object", "checkpoint"):
            if here.get(key) != recorded.get(key):
                what = plain(f"the run has {recorded.get(key)}, --model {here.get(key)}", 300)
                raise RunError(f"{key} of the model", f"{what}; give the model and the weights of the run")
    measuring = MeasuringOptions(allow_invalid=True, draws=1 if model is None else identity.measuring.draws)
    drawn = np.argsort(Rng.of(seed, "recheck").uniforms(rows.height), kind="stable")[:count]
    chosen = rows[sorted(drawn.tolist())]
    known = set(plan.benchmark.dataset.keys())
    if absent := sorted(set(chosen["sample"]) - known):
        raise RunError(absent[0], f"this dataset has no such sample (it has {len(known)}); use the data of the run")
    problems: list[tuple[str, str]] = []
    with temporary_worker(replace(plan.job(), measuring=measuring)) as worker:
        for row in chosen.iter_rows(named=True):
            (now,) = worker.run(Unit(row["sample"], row["corruption"], (row["severity"],))).rows
            if what := row_difference(row, now, model=model is not None, pixels=TOLERANCE_PX):
                problems.append((describe_cell(row["sample"], row["corruption"], row["severity"]), what))
    if problems:
        where, what = problems[0]
        culprit = "this model" if what == "flow" else "these data"
        settings = _different_options(identity, plan.identity) if what == "flow" else ""
        rows_differ = f"{len(problems)} of {chosen.height} rows do not match {culprit}"
        raise RunError(where, f"different {what}; {rows_differ}{settings}")
    drawn_rows = f"{chosen.height} of {rows.height} rows, drawn with seed {seed}"
    if model is not None:
        return f"{drawn_rows}, were predicted again and agree to within {TOLERANCE_PX} px in mean error"
    return f"{drawn_rows}, match the frames and ground truth of these data"


def _different_options(recorded: Identity, here: Identity) -> str:
    """Say which settings of the model differ from the record's, in a half-sentence; "" if none does."""
    named, given = (_flat(one.model.settings) for one in (recorded, here))
    keys = sorted(key for key in {*named, *given} if named.get(key) != given.get(key))
    differing = ", ".join(f"{key} is {named.get(key, 'not set')}, here {given.get(key, 'not set')}" for key in keys)
    return f"; of the record's model, {plain(differing, 300)}: give the options of the run with -O" if keys else ""


def _flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings without nesting: {"input": {"multiple": 8}} becomes {"input.multiple": 8}."""
    parts = {key: value if isinstance(value, Mapping) else {"": value} for key, value in settings.items()}
    return {f"{key}.{name}".rstrip("."): value for key, part in parts.items() for name, value in part.items()}

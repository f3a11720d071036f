"""Set up a finished run again, from its manifest, and measure some of its rows again: frames depend only on the data,
the corruption, its severity, the seed and the sample's key, so they can be recomputed without the model.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..core.errors import RobustFlowError, RunError, UsageError
from ..core.rng import Rng
from ..core.text import plain
from ..corruptions.user_corruptions import is_known
from ..data.benchmarks import BENCHMARKS, Benchmark
from ..data.benchmarks.facts import is_still, moving_name
from ..data.datasets import DATASETS
from ..metrics.rows import CLEAN
from ..models import ModelRef
from ..models.calls import describe_cell
from ..models.confidence import check_confidence
from .config import MeasuringOptions, RunConfig
from .identity import FrameIdentity, Identity, difference, differing_fields
from .plan import NO_MODEL, NamedModel, Plan, Unit, name_model
from .run import Run
from .setup import open_benchmark
from .source import RunSource
from .trust import row_difference
from .worker import temporary_worker

TOLERANCE_PX = 0.01
"""Tolerance for the means of one row, because rounding depends on the processor and the library."""


def restore_plan(run: Run, source: RunSource) -> Plan:
    """Return the plan of a finished run from its manifest, with the model and the data named in `source`."""
    identity = run.manifest.identity
    if source.model is None:
        raise RunError(run.path, "run with a Python object, which has no name; specify --model NAME")
    try:
        named = name_model(source.model)
    except RobustFlowError as error:
        raise RunError(run.path, f"its model can no longer be loaded: {error}") from error
    check_confidence(identity.measuring.confidence, named.model)
    plan = recorded_plan(identity, run.manifest.corruptions, source.data, source.data_options, named)
    if plan.identity != identity:
        differing = difference(plan.identity, identity)
        raise RunError(run.path, f"the setup differs from the run's in: {differing}; use its options")
    return plan


def recorded_plan(
    identity: Identity,
    corruptions: Iterable[str],
    data: str | Path | None,
    data_options: dict[str, Any],
    model: NamedModel = NO_MODEL,
) -> Plan:
    """Return the plan of some of a run's corruptions from its identity, without its attacks, which are not repeated.
    The frames have to be the same, but the model may be different, or absent."""
    recorded = identity.frames
    benchmark = _benchmark_of(recorded, data, data_options)
    if unknown := [name for name in recorded.corruptions if not is_known(name)]:
        why = "unknown corruption of the run: give it with --own-corruption, or install its package"
        raise RunError(plain(unknown[0]), why)
    # invalid pixels depend on the model, which may be absent
    measuring = MeasuringOptions(allow_invalid=True) if model is NO_MODEL else identity.measuring.options
    config = RunConfig(frames=recorded.options, measuring=measuring)
    plan = Plan(benchmark, model, config, attack_sources=recorded.attack_sources).of_corruptions(
        dict.fromkeys((*corruptions, *recorded.corruptions))
    )
    if differing := differing_fields(made := plan.identity.frames, recorded):
        parts = [f"{getattr(recorded, name)}, here {getattr(made, name)}" for name in differing]
        remedies = [words for name, words in _REMEDIES.items() if name in differing]
        raise RunError(
            ", ".join(differing),
            f"the frames computed here differ from those of the run ({plain('; '.join(parts), 300)}); "
            f"{remedies[0] if remedies else 'use the version of the run'}",
        )
    return plan


_REMEDIES = {
    "dataset": "use the data and data options of the run",
    "protocol": "use the data and data options of the run",
    "depth": "pass the depth maps of the run with -D depth=DIR and, if it had them, -D focal=PX and -D depth_unit=UNIT",
    "psf": "set ROBUSTFLOW_PSF_DIR to the same value as for the run",
    "corruptions": "pass the run's version of your corruption with --own-corruption",
}


def _benchmark_of(frames: FrameIdentity, data: str | Path | None, data_options: dict[str, Any]) -> Benchmark:
    """Return the benchmark of a run; raise if opening it would load code named in an untrusted file."""
    name = moving_name(frames.benchmark)
    if name not in BENCHMARKS and name not in DATASETS:
        raise RunError(plain(frames.benchmark), "unknown benchmark; code named in a run is never loaded")
    return open_benchmark(name, data, None, data_options, frames.variant, still=is_still(frames.benchmark))


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

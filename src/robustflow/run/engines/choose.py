"""Choose the engine for a run."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from dataclasses import replace

from ...core.errors import UsageError, unknown_name
from ...core.plugins import require
from ...core.processes import forks_children
from ...core.text import counted
from ...core.user_script import may_have_children
from ...models.devices import devices_of
from ..plan import Job, Plan, Unit
from .base import Engine, pickled
from .device import BATCHES_PER_FEEDER
from .processes import SERIAL, processes
from .ray import on_ray

ENGINES = ("serial", "processes", "ray")

_FEEDERS_PER_DEVICE = 8
"""Maximum default number of feeders per device; a cell takes 30 ms of CPU time, a prediction 10 ms on a fast GPU."""

_MOST_FEEDERS_PER_DEVICE = 240 // (1 + BATCHES_PER_FEEDER)
"""A child receives at most 256 file descriptors: here a pipe and the batches of each feeder."""

MOST_PROCESSES = 8
"""Maximum default number of processes, because each takes 300 MB or more."""

_CELLS_PER_PROCESS = 25
"""Several processes are the default only with at least this many cells per process, because the first one takes
about two seconds to start."""


def choose_engine(plan: Plan) -> Engine:
    """Return the engine that the user names, or the one that suits the model, the number of workers and the timeout."""
    asked_for, model = plan.config.compute, plan.model
    name, workers, timeout, address = asked_for.engine, asked_for.workers, asked_for.timeout, asked_for.address
    if name not in (None, *ENGINES):
        raise unknown_name("engine", str(name), ENGINES)
    if name == "ray":
        require("ray", "the ray engine")  # fail before the run is announced
        return _ray(workers, timeout, address)
    if address is not None:
        raise UsageError("--address", "applies only to the ray engine; add --engine ray, or omit it")
    several = "--workers" if (workers or 1) > 1 else "--timeout" if timeout is not None else None
    if name == "serial":
        if several is not None:
            raise UsageError(several, "serial runs have one worker and cannot stop a model; use --engine processes")
        return SERIAL
    devices = devices_of(model.ref, model.model)
    given = {"--engine": name, "--workers": workers, "--timeout": timeout}
    asked = next((option for option, value in given.items() if value is not None), None)
    if devices and plan.benchmark.attacks:
        if asked is not None:
            raise UsageError(asked, "attacks on an accelerator run in this process; omit this option, or --attacks")
        return _serial(" (attacks need the model in this process)")
    if asked is None:
        if not devices and not _is_light(plan):
            return SERIAL
        why = _reason_for_one_process(plan.job())
        if not devices:
            return _spread(why)
        if why:
            return _serial(why)
    elif not devices and name is None and several is None:
        return SERIAL
    if workers is not None and workers < len(devices):
        raise UsageError("--workers", f"{workers} is too few for {len(devices)} devices; name fewer with --device")
    feeders = max(len(devices), min(available_processors(), _FEEDERS_PER_DEVICE * len(devices)))
    return _pool(workers or feeders or 1, timeout, devices)


def suits_a_child(plan: Plan) -> bool:
    """Return whether a few more cells are faster in a new child than in this process, which may never have loaded what
    they need."""
    return forks_children() and _is_light(plan) and not _reason_for_one_process(plan.job())


def _is_light(plan: Plan) -> bool:
    return getattr(plan.model.model, "single_threaded", False) is True and plan.model.ref is not None


def _pool(workers: int, timeout: float | None, devices: Sequence[str] = ()) -> Engine:
    def parts(units: Sequence[Unit]) -> tuple[int, Sequence[str]]:
        most = max(1, len(units))
        used = devices[:most]
        return min(workers, most, _MOST_FEEDERS_PER_DEVICE * len(used) or most), used

    def describe(units: Sequence[Unit]) -> str:
        count, used = parts(units)
        if not used:
            return f"processes, {counted(count, 'worker')}"
        return f"processes, {counted(len(used), 'device')} + {counted(count, 'feeder')}"

    return Engine(describe, lambda job, units: processes(job, units, parts(units)[0], timeout, parts(units)[1]))


def _spread(why_not: str) -> Engine:
    """Return an engine with one process per CPU if each has enough work and nothing prevents it; otherwise `SERIAL`."""

    def engine(units: Sequence[Unit]) -> Engine:
        cells = sum(len(unit.severities) for unit in units)
        count = min(available_processors(), MOST_PROCESSES, cells // _CELLS_PER_PROCESS, len(units))
        if count < 2:
            return SERIAL
        return _serial(why_not) if why_not else _pool(count, None)

    return Engine(
        lambda units: engine(units).describe(units),
        lambda job, units: engine(units).compute(job, units),
    )


def _serial(why: str) -> Engine:
    return replace(SERIAL, describe=lambda units: f"serial{why}")


def _ray(workers: int | None, timeout: float | None, address: str | None) -> Engine:
    actors = "" if workers is None else f", {counted(workers, 'actor')}"
    return Engine(
        lambda units: f"ray{actors}, {'on this machine' if address is None else address}",
        lambda job, units: on_ray(job, units, workers, timeout, address),
    )


def _reason_for_one_process(job: Job) -> str:
    """Return the reason why a run cannot use several processes by default; empty if it can."""
    if multiprocessing.parent_process() is not None:
        return " (this process is itself a worker)"
    if not may_have_children():
        return ' (worker processes require the script\'s code to be under `if __name__ == "__main__":`)'
    try:
        pickled(job)
    except UsageError as error:
        return f" (the {error.culprit} cannot be sent to another process)"
    return ""


def available_processors() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

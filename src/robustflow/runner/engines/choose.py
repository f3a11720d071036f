"""Which engine computes a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ...errors import UsageError, unknown_name
from ...runs.plan import Unit
from .base import FinishedUnit, Job
from .processes import processes
from .ray import on_ray
from .serial import serial

ENGINES = ("serial", "processes", "ray")

Engine = Callable[[Job, list[Unit]], Iterator[FinishedUnit]]
"""Computes units, each once, in any order that puts a sample's clean unit first."""


def choose_engine(
    name: str | None, workers: int | None = None, timeout: float | None = None, address: str | None = None
) -> Engine:
    """The engine of a name, or the one that the number of workers and the timeout ask for.

    Raises:
        UsageError: an unknown name, or workers or a timeout that the engine does not support.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers} is out of range: give 1 or more")
    if timeout is not None and timeout <= 0:
        raise UsageError(f"no model can answer within a timeout of {timeout:g} s: give more than 0")
    if name is None:
        name = "processes" if (workers or 1) > 1 or timeout is not None else "serial"
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    if address is not None and name != "ray":
        raise UsageError(f"--address is for the ray engine, not for {name}; give --engine ray with it, or leave it out")
    if name == "ray":
        return lambda job, units: on_ray(job, units, workers, timeout, address)
    if name == "processes":
        return lambda job, units: processes(job, units, max(1, min(workers or 1, len(units))), timeout)
    if (workers or 1) > 1 or timeout is not None:
        raise UsageError("the serial engine has one worker and cannot stop a model that hangs; use --engine processes")
    return serial

"""Compute with actors on the nodes of a Ray cluster, or on this machine: one per GPU, or one per CPU.

Only the driver writes rows and tracks which actor computes which unit, so actors and nodes can be lost at any time:
another actor gets the unit. Ray's restarts are disabled, because a restarted actor would keep its unit while it waits
for free resources, forever if its node is lost for good.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from uuid import uuid4

from ...core.environment import ONE_THREAD
from ...core.errors import RunError, UsageError
from ...core.processes import rebuilt
from ...core.text import first_of
from ...models.calls import describe_cell
from ...models.devices import device_of, is_accelerator
from ..computation import FinishedUnit
from ..data_files import files_of_sample
from ..plan import Job, Unit
from .base import FinishedUnits, Schedule, crash_of, pickled
from .processes import too_slow
from .ray_actor import Doing, Files, Start, UnitActor, cannot_start, installed
from .ray_cluster import connected, ray_module

ATTEMPTS = 3
"""Maximum number of actors that may be lost while computing the same unit, or, per worker, while starting."""
_LOOK_S = 1.0
"""Interval between checks of the cluster's resources, in seconds."""
_PATIENCE_S = 30.0
"""Time without any actor after which a warning is printed, in seconds."""


def on_ray(
    job: Job, units: Sequence[Unit], workers: int | None, timeout: float | None, address: str | None
) -> FinishedUnits:
    """Compute the units on a Ray cluster."""
    gpu = _needs_gpu(job)
    sent = bytes(pickled(job, ray_module().cloudpickle.dumps))
    start = Start(
        variables={name: value for name, value in os.environ.items() if name.startswith("ROBUSTFLOW_")} | ONE_THREAD,
        folder=os.getcwd(),
        path=sys.path if address is None else [os.path.abspath(folder) for folder in sys.path[:1]],  # of the script
        installed=installed(),
    )
    with connected(address, workers, len(sent)) as ray:
        crew = _Crew(ray, job, (ray.put(sent), start), units, workers, "GPU" if gpu else "CPU", timeout)
        try:
            yield from crew.compute()
        finally:
            for member in crew.members:
                crew.kill(member)


def _needs_gpu(job: Job) -> bool:
    """Return whether every actor needs its own GPU."""
    listed = job.model.ref.devices() if job.model.ref else ()
    if any(":" in device for device in listed):
        raise UsageError(
            "--device",
            f"{','.join(listed)} is not available with the ray engine: use cuda; Ray assigns each worker its own GPU",
        )
    return is_accelerator(listed[0] if listed and listed[0] != "auto" else device_of(job.model.model))


def files_of(job: Job, unit: Unit) -> Files:
    """Return paths and sizes of the files a node needs for a unit."""
    files = files_of_sample(job.dataset, unit.key, job.window, job.depth)
    return tuple((str(path), path.stat().st_size) for path in files)


@dataclass(eq=False)
class _Member:
    """An actor. Each call is answered before the next one is made; `call` is the pending call."""

    actor: Any
    call: Any
    place: str = ""
    """The actor's node and device; "" until it has loaded the model."""
    unit: Unit | None = None
    last_key: str | None = None
    doing: Doing | None = None
    predicting: tuple[str, str] = ("", "")
    """The latest reading of `doing`."""
    since: float = 0.0


class _Crew:
    """Manage the actors of a run and the remaining units."""

    def __init__(
        self,
        ray: Any,
        job: Job,
        start: tuple[Any, Start],
        units: Sequence[Unit],
        workers: int | None,
        kind: str,
        timeout: float | None,
    ) -> None:
        self.members: list[_Member] = []
        self._timeout, self._wait_s = timeout, min(_LOOK_S, (timeout or _LOOK_S) / 4)
        self._ray, self._job, self._start, self._workers, self._kind = ray, job, start, workers, kind
        self._schedule, self._left = Schedule(units), len(units)
        self._losses: dict[Unit | None, list[str]] = {}
        """Actors lost while computing each unit and, for None, while starting since one has started."""
        self._most = 0
        """Largest number of GPUs or CPUs that the cluster has had; those of a lost node may come back."""
        self._heard = time.monotonic()
        self._looked = self._heard - _LOOK_S
        self._warned = False

    def compute(self) -> FinishedUnits:
        while self._left:
            self._fill_up()
            calls = {member.call: member for member in self.members if member.call is not None}
            self._check_timeouts()
            for call in self._ray.wait(list(calls), timeout=self._wait_s)[0] if calls else ():
                done = self._receive(calls[call])
                for member in self.members:
                    unit = self._schedule.take(member.last_key) if member.place and member.call is None else None
                    if unit is not None:
                        member.unit, member.last_key = unit, unit.key
                        member.call = member.actor.run.remote(unit, files_of(self._job, unit))
                if done is not None:
                    self._left -= 1
                    yield done

    def _fill_up(self) -> None:
        """Start as many actors as fit on the cluster; the rest start when a node joins."""
        now = time.monotonic()
        if now - self._looked < _LOOK_S:
            return
        self._looked = now
        self._most = max(self._most, int(self._ray.cluster_resources().get(self._kind, 0)))
        wanted = self._workers or self._most
        if not wanted:
            raise RunError(self._kind, "Ray knows of none on its nodes; use --workers N to wait for N of them to join")
        for _ in range(min(wanted, self._left) - len(self.members)):
            resources = {"num_cpus": 1, "num_gpus": int(self._kind == "GPU"), "scheduling_strategy": "SPREAD"}
            actor = self._ray.remote(UnitActor).options(max_restarts=0, max_task_retries=0, **resources).remote()
            key = None if self._timeout is None else f"robustflow {uuid4().hex}"
            call = actor.begin.remote(*self._start, key)
            self.members.append(_Member(actor, call, doing=None if key is None else Doing(key)))
        if any(member.place for member in self.members):
            self._heard = now
        elif now - self._heard > _PATIENCE_S and not self._warned:
            self._warned = True
            warnings.warn(f"no {self._kind} in the Ray cluster is free; waiting for one", stacklevel=2)

    def _check_timeouts(self) -> None:
        for member in self.members:
            if member.doing is None or member.unit is None:
                continue
            predicting = member.doing.read()
            if predicting != member.predicting:
                member.predicting, member.since = predicting, time.monotonic()
            elif self._timeout is not None and predicting[1] and time.monotonic() - member.since > self._timeout:
                node = f"(on node {member.place.partition(',')[0]})"
                raise too_slow(self._timeout, f"{predicting[1]} {node}")

    def _receive(self, member: _Member) -> FinishedUnit | None:
        """Read the answer to an actor's call, to `begin` or to `run`."""
        exceptions = self._ray.exceptions
        call, member.call = member.call, None
        try:
            kind, value = self._ray.get(call)
        except exceptions.RayError as error:
            if isinstance(error, exceptions.RayTaskError) or "creation task" in str(error):
                raise cannot_start(error) from error
            self._remove(member, error)
            return None
        if kind == "error":
            raise rebuilt(*value)
        if member.unit is None:
            member.place = value
            self._losses.pop(None, None)
            return None
        member.unit = None
        self._schedule.finished(value.unit)
        return replace(value, place=member.place)

    def _remove(self, member: _Member, error: Exception) -> None:
        """Remove a lost actor; its unit is computed again."""
        self.members.remove(member)
        self.kill(member)
        self._looked -= _LOOK_S
        unit, losses = member.unit, self._losses.setdefault(member.unit, [])
        node = f"node {member.place.partition(',')[0]}" if member.place else "a node"
        losses.append(f"{node} ({type(error).__name__})")
        if len(losses) == (ATTEMPTS if unit else ATTEMPTS * max(1, self._workers or self._most)):
            raise RunError(
                describe_cell(unit.key, unit.corruption, *unit.severities) if unit else "start of a Ray worker",
                f"{len(losses)} worker processes crashed or were lost (on {first_of(losses, ATTEMPTS)}): "
                f"{crash_of(self._job.model.label)}, or free memory on the nodes",
            )
        if unit:
            self._schedule.give_back(unit)

    def kill(self, member: _Member) -> None:
        with suppress(Exception):  # the actor or the cluster is already gone
            self._ray.kill(member.actor, no_restart=True)
            if member.doing is not None:
                member.doing.delete()

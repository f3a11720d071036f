"""Compute with actors on the nodes of a Ray cluster, or on this machine: one per GPU, or one per CPU.

Only the driver writes rows and tracks which actor computes which unit, so actors and nodes can be lost at any time:
their units are assigned again. Ray's retries are disabled, because they could run a unit twice when its result is
merely late.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Sequence
from typing import Any

from ...core.errors import RunError, UsageError
from ...core.processes import ONE_THREAD, rebuilt
from ...corruptions.stack import needs_depth
from ...models import ModelSpec
from ...models.base import describe_cell
from ...models.loading import device_of, is_accelerator
from ..data_files import files_of_sample
from ..plan import Unit
from .base import FinishedUnit, FinishedUnits, Job, Schedule, pickled
from .processes import too_slow
from .ray_actor import UnitActor, cannot_start, check_installed, installed
from .ray_cluster import connected, ray_module

ATTEMPTS = 3
"""Maximum number of actors that may be lost while computing the same unit."""
_LOOK_S = 1.0
"""Interval between checks of the cluster's resources, in seconds."""
_PATIENCE_S = 30.0
"""Time without any actor after which a warning is printed, in seconds."""
_UNANSWERED_S = 30.0
"""Time in seconds, beyond the timeout of a prediction, for which an actor may be silent, as in code that holds the
interpreter's lock."""


def on_ray(
    job: Job, units: Sequence[Unit], workers: int | None, timeout: float | None, address: str | None
) -> FinishedUnits:
    """Compute the units on a Ray cluster."""
    gpu = _needs_gpu(job)
    sent = bytes(pickled(job, ray_module().cloudpickle.dumps))
    with connected(address, workers, len(sent)) as ray:
        crew = _Crew(ray, job, sent, units, workers, timeout, gpu, address is None)
        try:
            yield from crew.compute()
        finally:
            for member in crew.members:
                member.kill()


def _needs_gpu(job: Job) -> bool:
    """Return whether every actor needs its own GPU."""
    listed = job.model.devices() if isinstance(job.model, ModelSpec) else ()
    if any(":" in device for device in listed):
        raise UsageError(
            "--device",
            f"{','.join(listed)} is not available with the ray engine: use cuda; Ray assigns each worker its own GPU",
        )
    return is_accelerator(listed[0] if listed and listed[0] != "auto" else device_of(job.load_model()))


def files_of(job: Job, unit: Unit) -> tuple[tuple[str, int], ...]:
    """Return paths and sizes of the files a node needs for a unit; of depth only if its corruption needs it."""
    options, attacked = job.options, unit.corruption in job.options.attacks
    depths = None if attacked or not needs_depth(unit.corruption) else options.depth
    files = files_of_sample(job.dataset, unit.key, options.window, depths)
    return tuple((str(path), path.stat().st_size) for path in files)


class _Crew:
    """Manage the actors of a run and the remaining units."""

    def __init__(
        self,
        ray: Any,
        job: Job,
        sent: bytes,
        units: Sequence[Unit],
        workers: int | None,
        timeout: float | None,
        gpu: bool,
        local: bool,
    ) -> None:
        self.members: list[_Member] = []
        self._ray, self._job = ray, job
        self._workers, self._timeout, self._gpu, self._local = workers, timeout, gpu, local
        self._schedule, self._left = Schedule(units), len(units)
        self._installed = installed()
        variables = {name: value for name, value in os.environ.items() if name.startswith("ROBUSTFLOW_")} | ONE_THREAD
        folders = sys.path if local else [os.path.abspath(folder) for folder in sys.path[:1]]  # folder of the script
        self._greeting = variables, os.getcwd(), folders
        identity = job.model_identity(job.load_model())
        self._start = ray.put(sent), identity, files_of(job, units[0]) if units else ()
        self._losses: dict[Unit, list[str]] = {}
        self._failed_starts = 0
        self._most = 0
        """Largest number of GPUs or CPUs that the cluster has had; those of a lost node may come back."""
        self._heard = time.monotonic()
        self._looked = self._heard - _LOOK_S
        self._warned = False

    def compute(self) -> FinishedUnits:
        tick = _LOOK_S if self._timeout is None else min(_LOOK_S, max(0.05, self._timeout / 4))
        while self._left:
            self._fill_up()
            calls = {member.call: member for member in self.members if member.call is not None}
            if not calls:
                continue
            for call in self._ray.wait(list(calls), timeout=tick)[0]:
                done = self._receive(calls[call])
                for member in self.members:
                    if member.device is not None and member.call is None:
                        unit = self._schedule.take(member.last_key)
                        if unit is not None:
                            member.give(unit, files_of(self._job, unit))
                if done is not None:
                    self._left -= 1
                    yield done
            if self._timeout is not None:
                for member in self.members:
                    member.check(self._timeout)

    def _fill_up(self) -> None:
        """Start as many actors as fit on the cluster; the rest start when a node joins."""
        now = time.monotonic()
        if now - self._looked < _LOOK_S:
            return
        self._looked = now
        kind = "GPU" if self._gpu else "CPU"
        self._most = max(self._most, int(self._ray.cluster_resources().get(kind, 0)))
        wanted = self._workers or self._most
        if not wanted:
            where = "this machine" if self._local else "the Ray cluster"
            raise RunError(f"{where} has no {kind} known to Ray; use --workers N to wait for N of them to join")
        while len(self.members) < min(wanted, self._left):
            self.members.append(_Member(self._ray, self._gpu, self._timeout is not None))
            self.members[-1].call = self.members[-1].actor.hello.remote(*self._greeting)
        if any(member.host for member in self.members):
            self._heard = now
        elif now - self._heard > _PATIENCE_S and not self._warned:
            self._warned = True
            warnings.warn(f"no {kind} in the Ray cluster is free; waiting for one", stacklevel=2)

    def _receive(self, member: _Member) -> FinishedUnit | None:
        """Read the answer to an actor's call: to `hello`, `begin` or `run`."""
        exceptions = self._ray.exceptions
        call, member.call = member.call, None
        try:
            answer = self._ray.get(call)
        except exceptions.RayError as error:
            if isinstance(error, exceptions.RayTaskError) or "creation task" in str(error):
                raise cannot_start(error) from error
            self._remove(member, error)
            return None
        if member.host is None:
            member.host, there = answer
            check_installed(member.host, self._installed, there)
            member.call = member.actor.begin.remote(*self._start)
            return None
        kind, value = answer
        if kind == "error":
            name, message, *rest = value
            raise rebuilt(name, message if self._local else f"{message} (on node {member.host})", *rest)
        if member.device is None:
            member.device, self._failed_starts = value, 0
            return None
        unit, member.unit, member.question = member.unit, None, None
        assert unit is not None
        self._schedule.finished(unit)
        rows, seconds = value
        return FinishedUnit(unit, rows, seconds, f"{member.host}, {member.device}")

    def _remove(self, member: _Member, error: Exception) -> None:
        """Remove a lost actor; its unit is computed again."""
        self.members.remove(member)
        member.kill()
        self._looked -= _LOOK_S
        where = f"{f'node {member.host}' if member.host else 'a node'} ({type(error).__name__})"
        if member.unit is None:
            self._failed_starts += 1
            if self._failed_starts >= ATTEMPTS * max(1, self._workers or self._most):
                raise RunError(
                    f"no worker could be started on the Ray cluster: {self._failed_starts} were lost while starting, "
                    f"the last on {where}; the usual causes are lack of memory or a crash while loading the model"
                )
            return
        unit, losses = member.unit, self._losses.setdefault(member.unit, [])
        losses.append(where)
        if len(losses) == ATTEMPTS:
            raise RunError(
                f"a worker exited without an error message while computing {_described(unit)}, {ATTEMPTS} times (on "
                f"{', '.join(losses)}); the usual causes are lack of memory or a crash inside the model: try fewer "
                "--workers"
            )
        self._schedule.give_back(unit)


class _Member:
    """An actor. Each call is answered before the next one is made; `call` is the pending call."""

    def __init__(self, ray: Any, gpu: bool, watched: bool) -> None:
        self._ray = ray
        options = {
            "num_cpus": 1,
            "num_gpus": int(gpu),
            "max_restarts": 0,
            "max_task_retries": 0,
            "max_concurrency": 2 if watched else 1,
            "scheduling_strategy": "SPREAD",
        }
        self.actor = ray.remote(UnitActor).options(**options).remote()
        self.call: Any = None
        self.host: str | None = None
        self.device: str | None = None
        self.unit: Unit | None = None
        self.last_key: str | None = None
        self.question: Any = None
        """The pending question about the current prediction."""
        self._asked = 0.0

    def give(self, unit: Unit, files: Sequence[tuple[str, int]]) -> None:
        self.unit, self.last_key = unit, unit.key
        self.call = self.actor.run.remote(unit, files)

    def check(self, timeout: float) -> None:
        """End the run if a prediction takes too long. Call this repeatedly."""
        if self.unit is None:
            return
        now = time.monotonic()
        if self.question is None:
            if now - self._asked > min(timeout / 4, 5.0):
                self.question, self._asked = self.actor.predicting.remote(), now
        elif self._ray.wait([self.question], timeout=0)[0]:
            try:
                predicting = self._ray.get(self.question)
            except self._ray.exceptions.RayError:  # the call for the unit reports the error too
                predicting = None
            self.question = None
            if predicting is not None and predicting[1] > timeout:
                raise too_slow(timeout, predicting[0])
        elif now - self._asked > timeout + _UNANSWERED_S:
            raise too_slow(timeout, _described(self.unit))

    def kill(self) -> None:
        try:
            self._ray.kill(self.actor, no_restart=True)
        except Exception:  # the actor or the cluster is already gone
            return


def _described(unit: Unit) -> str:
    return describe_cell(unit.key, unit.corruption, *unit.severities)

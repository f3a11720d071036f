"""The driver's view of an actor: its node, its last call, and its current unit."""

from __future__ import annotations

import time
from typing import Any

from ...models.base import describe_cell
from ...runs.plan import Unit
from .prediction_timeout import too_slow
from .ray_actor import Files, UnitActor

_UNANSWERED_S = 30.0
"""Time in seconds, beyond the timeout of a prediction, for which an actor may be silent; a lost node is detected
within this time."""


class Member:
    """An actor. Each call is answered before the next one is made; `call` is the pending call.

    Attributes:
        host: name of the node; None until the actor has reported it.
        device: device of the model; None until the model is loaded.
        unit: unit that the actor is computing.
        last_key: key of the sample that the actor has loaded.
    """

    def __init__(self, ray: Any, gpu: bool, watched: bool) -> None:
        self._ray = ray
        self._actor = (
            ray.remote(UnitActor)
            .options(
                num_cpus=1,
                num_gpus=int(gpu),
                max_restarts=0,
                max_task_retries=0,
                max_concurrency=2 if watched else 1,
                scheduling_strategy="SPREAD",
            )
            .remote()
        )
        self.call: Any = None
        self.host: str | None = None
        self.device: str | None = None
        self.unit: Unit | None = None
        self.last_key: str | None = None
        self._question: Any = None
        self._asked = 0.0

    @property
    def is_idle(self) -> bool:
        """Return whether the actor is waiting for a unit."""
        return self.device is not None and self.call is None

    def greet(self, variables: dict[str, str], folder: str, path: list[str]) -> None:
        """Call `UnitActor.hello`."""
        self.call = self._actor.hello.remote(variables, folder, path)

    def begin(self, host: str, pickled: Any, identity: dict[str, Any], files: Files) -> None:
        """Call `UnitActor.begin`."""
        self.host = host
        self.call = self._actor.begin.remote(pickled, identity, files)

    def give(self, unit: Unit, files: Files) -> None:
        """Make the actor compute a unit."""
        self.unit, self.last_key = unit, unit.key
        self.call = self._actor.run.remote(unit, files)

    def take_call(self) -> Any:
        """Return the call that has been answered, and mark the actor as idle."""
        call, self.call = self.call, None
        return call

    def finish(self) -> Unit:
        """Return the unit, which has now been computed."""
        unit, self.unit, self._question = self.unit, None, None
        assert unit is not None
        return unit

    def check(self, timeout: float) -> None:
        """End the run if a prediction takes too long. Call this repeatedly.

        Raises:
            ModelError: the prediction takes too long, or keeps the actor from responding.
        """
        if self.unit is None:
            return
        now = time.monotonic()
        if self._question is None:
            if now - self._asked > min(timeout / 4, 5.0):
                self._question, self._asked = self._actor.predicting.remote(), now
            return
        if self._ray.wait([self._question], timeout=0)[0]:
            try:
                predicting = self._ray.get(self._question)
            except self._ray.exceptions.RayError:  # the call for the unit reports the error too
                predicting = None
            self._question = None
            if predicting is not None and predicting[1] > timeout:
                raise too_slow(timeout, predicting[0])
        elif now - self._asked > timeout + _UNANSWERED_S:
            raise too_slow(timeout, describe_cell(self.unit.key, self.unit.corruption, *self.unit.severities))

    def kill(self) -> None:
        """End the actor immediately."""
        try:
            self._ray.kill(self._actor, no_restart=True)
        except Exception:  # the actor or the cluster is already gone
            return

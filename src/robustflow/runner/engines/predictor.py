"""A process that only predicts: it keeps the model on its device and shares memory with the device's feeders."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING

from ...models import ModelSpec
from ...models.base import AnyModel
from ..predict_stage import PredictionRequest, PredictStage
from ..seconds import no_seconds, pop_timings
from .shared_slots import SharedSlots

if TYPE_CHECKING:  # imported only by processes that need it
    from ...runs.cells import Cell


@dataclass(frozen=True)
class SlotRequest:
    """A `PredictionRequest` whose frames are in a slot; the flow is written into the same slot."""

    cell: Cell
    slot: int
    slot_bytes: int
    shape: tuple[int, int, int, int]
    index: int | None
    draws: int


Link = tuple[Connection, SharedSlots]
"""A connection to one feeder. It receives lists of `SlotRequest` and sends the prediction time of each list in seconds,
in the same order."""


def predict_forever(driver: Connection, model: ModelSpec | AnyModel, confidence: str | None, links: list[Link]) -> None:
    """Predict batches in the order in which they arrive; the main function of a predicting process."""
    seconds = no_seconds()
    loaded = model.load() if isinstance(model, ModelSpec) else model
    stage = PredictStage(loaded, confidence, seconds, lambda what: driver.send(("predicting", what)))
    slots = dict(links)
    waiting: deque[tuple[Connection, list[SlotRequest]]] = deque()
    while True:
        for ready in wait([driver, *slots], timeout=0 if waiting else None):
            assert isinstance(ready, Connection)
            if ready is driver:
                driver.recv()  # raises EOFError, because the other end sends nothing before it closes
                continue
            try:
                waiting.append((ready, ready.recv()))
            except (EOFError, ConnectionError):  # the driver notices when a feeder ends
                del slots[ready]
        if waiting:
            link, batch = waiting.popleft()
            if link not in slots:
                continue
            _answer(stage, slots[link], batch)
            try:
                link.send(pop_timings(seconds)["predict"])
            except OSError:
                del slots[link]


def _answer(stage: PredictStage, slots: SharedSlots, batch: list[SlotRequest]) -> None:
    requests = [
        PredictionRequest(one.cell, tuple(slots.frames(one.slot, one.slot_bytes, one.shape)), one.index, one.draws)
        for one in batch
    ]
    for one, flow in zip(batch, stage.predict(requests), strict=True):
        slots.flow(one.slot, one.slot_bytes, flow.shape)[:] = flow

"""Compute all units in this process: for debugging, and for models that cannot be sent to other processes."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator

from ...runs.plan import Unit
from ...threads import one_opencv_thread
from ..seconds import pop_timings
from .base import Engine, FinishedUnit, FinishedUnits, Job


def serial(job: Job, units: Iterable[Unit]) -> FinishedUnits:
    """Compute the units in sequence; if the model can attack pairs in batches, units of the same attack are grouped."""
    worker = job.worker()
    attacks = job.options.attacks if worker.batches_attacks else ()
    with one_opencv_thread():
        for group in _grouped(units, attacks, job.batch_size):
            rows = worker.run_attack(group) if len(group) > 1 else [worker.run(group[0])]
            for unit, of_unit in zip(group, rows, strict=True):
                yield FinishedUnit(unit, of_unit, pop_timings(worker.seconds))


def _grouped(units: Iterable[Unit], attacks: Container[str], cells: int) -> Iterator[list[Unit]]:
    """Group the units of each attack into groups of at least `cells` cells; every other unit forms its own group, in
    the original order.

    >>> units = [Unit(key, name, (1, 3)) for key in "ab" for name in ("fog", "pgd")]
    >>> [[unit.key for unit in group] for group in _grouped(units, ["pgd"], 4)]
    [['a'], ['b'], ['a', 'b']]
    """
    waiting: dict[str, list[Unit]] = {}
    for unit in units:
        if unit.corruption not in attacks:
            yield [unit]
            continue
        group = waiting.setdefault(unit.corruption, [])
        group.append(unit)
        if sum(len(each.cells) for each in group) >= cells:
            yield waiting.pop(unit.corruption)
    yield from waiting.values()


SERIAL = Engine(lambda units: "serial", serial)

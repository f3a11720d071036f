"""The order in which units are assigned to workers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.metrics.rows import CLEAN
from robustflow.run.engines.base import Schedule
from robustflow.run.plan import Unit


def _units(samples, corruptions, without_clean=()):
    units = []
    for sample in range(samples):
        if sample not in without_clean:
            units.append(Unit(str(sample), CLEAN, (0,)))
        units += [Unit(str(sample), f"c{index}", (1, 2, 4)) for index in range(corruptions)]
    return units


@given(
    samples=st.integers(1, 4),
    corruptions=st.integers(1, 4),
    without_clean=st.sets(st.integers(0, 3)),
    workers=st.integers(1, 5),
    choices=st.lists(st.integers(0, 4), min_size=200, max_size=200),
)
def test_any_number_of_workers_does_every_unit_once_and_clean_ones_first(
    samples, corruptions, without_clean, workers, choices
):
    units = _units(samples, corruptions, without_clean)
    schedule = Schedule(units)
    busy: dict[int, Unit] = {}
    last: dict[int, str | None] = dict.fromkeys(range(workers))
    finished: list[Unit] = []
    for choice in choices:
        for worker in range(workers):
            if worker not in busy and (unit := schedule.take(last[worker])) is not None:
                if unit.corruption != CLEAN and int(unit.key) not in without_clean:
                    assert Unit(unit.key, CLEAN, (0,)) in finished
                busy[worker], last[worker] = unit, unit.key
        if not busy:
            break
        worker = sorted(busy)[choice % len(busy)]
        finished.append(busy.pop(worker))
        schedule.finished(finished[-1])
    assert sorted(finished, key=repr) == sorted(units, key=repr)
    assert schedule.left == 0


def test_a_worker_stays_with_its_sample_and_gets_the_plans_last_units_first():
    schedule = Schedule(_units(3, 3))
    assert schedule.take(None) == Unit("0", CLEAN, (0,))
    assert [schedule.take("0").corruption for _ in range(3)] == ["c2", "c1", "c0"]
    assert schedule.take("0") == Unit("1", CLEAN, (0,))


def test_another_worker_helps_with_a_sample_once_its_clean_flow_exists():
    schedule = Schedule(_units(1, 3))
    clean = schedule.take(None)
    assert schedule.take(None) is None
    schedule.finished(clean)
    assert [schedule.take(None).corruption for _ in range(2)] == ["c2", "c1"]


@pytest.mark.parametrize("lost", [Unit("0", CLEAN, (0,)), Unit("0", "c1", (1, 2, 4))])
def test_a_lost_unit_comes_before_the_rest_of_its_sample(lost):
    schedule = Schedule(_units(1, 2))
    schedule.finished(schedule.take(None))
    schedule.take("0")
    schedule.give_back(lost)
    assert schedule.take(None) == lost

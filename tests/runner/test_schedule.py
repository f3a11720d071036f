"""The order in which units are assigned."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robustflow.metrics.rows import CLEAN
from robustflow.runner.engines.schedule import Schedule
from robustflow.runs.plan import Unit


def _units(samples: int, corruptions: int, without_clean: set[int]) -> list[Unit]:
    units = []
    for sample in range(samples):
        if sample not in without_clean:
            units.append(Unit(str(sample), CLEAN, (0,)))
        units += [Unit(str(sample), f"c{index}", (1, 2)) for index in range(corruptions)]
    return units


@given(
    samples=st.integers(1, 4),
    corruptions=st.integers(1, 4),
    without_clean=st.sets(st.integers(0, 3)),
    workers=st.integers(1, 5),
    choices=st.lists(st.integers(0, 4), min_size=200, max_size=200),
)
def test_any_number_of_workers_does_everything_once_and_clean_first(
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


def test_a_worker_stays_with_its_sample():
    schedule = Schedule(_units(3, 3, set()))
    first = schedule.take(None)
    assert first == Unit("0", CLEAN, (0,))
    schedule.finished(first)
    assert [schedule.take("0").key for _ in range(3)] == ["0"] * 3
    assert schedule.take("0") == Unit("1", CLEAN, (0,))


def test_units_of_a_sample_after_the_clean_one_come_from_the_plans_end():
    schedule = Schedule(_units(1, 3, set()))
    schedule.finished(schedule.take(None))
    assert [schedule.take("0").corruption for _ in range(2)] == ["c2", "c1"]
    schedule.give_back(Unit("0", "c1", (1, 2)))
    assert schedule.take("0").corruption == "c1"

"""The order in which units and cells are assigned, and how rows of cells are collected into units."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.metrics.rows import CLEAN
from robustflow.run.engines.base import Schedule
from robustflow.run.engines.staged import CellSchedule
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


def test_a_worker_stays_with_its_sample():
    schedule = Schedule(_units(3, 3))
    first = schedule.take(None)
    assert first == Unit("0", CLEAN, (0,))
    schedule.finished(first)
    assert [schedule.take("0").key for _ in range(3)] == ["0"] * 3
    assert schedule.take("0") == Unit("1", CLEAN, (0,))


def test_units_of_a_sample_after_the_clean_one_come_from_the_plans_end():
    schedule = Schedule(_units(1, 3))
    schedule.finished(schedule.take(None))
    assert [schedule.take("0").corruption for _ in range(2)] == ["c2", "c1"]
    schedule.give_back(Unit("0", "c1", (1, 2, 4)))
    assert schedule.take("0").corruption == "c1"


@settings(max_examples=30)
@given(
    samples=st.integers(1, 4),
    corruptions=st.integers(1, 3),
    without_clean=st.sets(st.integers(0, 3)),
    feeders=st.integers(1, 4),
    random=st.randoms(use_true_random=False),
)
def test_any_number_of_feeders_does_every_unit_once_and_clean_ones_first(
    samples, corruptions, without_clean, feeders, random
):
    units = _units(samples, corruptions, without_clean)
    schedule = CellSchedule(units)
    busy = [[] for _ in range(feeders)]
    last = [None] * feeders
    asked, finished = [], []
    for _ in range(200):
        feeder = random.randrange(feeders)
        cell = schedule.take(last[feeder], random.random() < 0.5)
        if cell is not None:
            key, corruption, _ = cell
            if corruption != CLEAN and int(key) not in without_clean:
                clean = (key, CLEAN, 0)
                mine = clean in busy[feeder]
                assert mine or any(done.unit.key == key and done.unit.corruption == CLEAN for done in finished)
            schedule.learn(corruption, random.random())
            busy[feeder].append(cell)
            last[feeder] = key
            asked.append(cell)
        if busy[feeder] and (cell is None or random.random() < 0.3):
            done = busy[feeder].pop(0)  # a device returns its results in order
            if (unit := schedule.finish(done, {"cell": done}, {"measure": 1.0})) is not None:
                finished.append(unit)
    for done in (cell for cells in busy for cell in cells):
        if (unit := schedule.finish(done, {"cell": done}, {"measure": 1.0})) is not None:
            finished.append(unit)
    assert len(asked) == len(set(asked))
    assert schedule.finished == (len(asked) == sum(len(unit.cells) for unit in units))
    for done in finished:
        assert [row["cell"] for row in done.rows] == done.unit.cells
        assert done.seconds == {"measure": len(done.rows)}


def test_costly_cells_come_while_frames_wait_and_cheap_ones_while_they_run_out():
    schedule = CellSchedule(_units(1, 3))
    assert schedule.take(None, False)[1] == CLEAN
    assert schedule.take("0", False) == ("0", "c0", 1)
    schedule.learn("c0", 0.1)
    assert schedule.take("0", True) == ("0", "c2", 1), "the cost is unknown, so the last cell of the plan comes first"
    schedule.learn("c2", 0.6)
    assert schedule.take("0", True) == ("0", "c1", 1)
    schedule.learn("c1", 0.01)
    assert schedule.take("0", True) == ("0", "c2", 2)
    assert [schedule.take("0", False)[1] for _ in range(4)] == ["c1", "c1", "c0", "c0"]


def test_second_feeder_starts_a_different_sample_and_helps_with_the_last():
    schedule = CellSchedule(_units(2, 1))
    assert schedule.take(None, False) == ("0", CLEAN, 0)
    assert schedule.take(None, False) == ("1", CLEAN, 0)
    assert [schedule.take("0", False) for _ in range(3)] == [("0", "c0", severity) for severity in (1, 2, 4)]
    assert schedule.take("0", False) is None, "only the other feeder may work on sample 1 until its clean flow exists"
    schedule.finish(("1", CLEAN, 0), {}, {})
    assert schedule.take("0", False) == ("1", "c0", 1)

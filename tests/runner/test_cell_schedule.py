"""Cells are assigned in the right order, and their rows are collected into units."""

from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.metrics.rows import CLEAN
from robustflow.runner.engines.cell_schedule import CellSchedule
from robustflow.runs.plan import Unit


def _units(samples, corruptions, without_clean=()):
    units = []
    for sample in range(samples):
        if sample not in without_clean:
            units.append(Unit(str(sample), CLEAN, (0,)))
        units += [Unit(str(sample), f"c{index}", (1, 2, 4)) for index in range(corruptions)]
    return units


@settings(max_examples=30)
@given(
    samples=st.integers(1, 4),
    corruptions=st.integers(1, 3),
    without_clean=st.sets(st.integers(0, 3)),
    feeders=st.integers(1, 4),
    random=st.randoms(use_true_random=False),
)
def test_everything_once_and_clean_first(samples, corruptions, without_clean, feeders, random):
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
    for feeder in range(feeders):
        for done in busy[feeder]:
            if (unit := schedule.finish(done, {"cell": done}, {"measure": 1.0})) is not None:
                finished.append(unit)
        busy[feeder] = []
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


def test_a_second_feeder_begins_another_sample_and_helps_with_the_last():
    schedule = CellSchedule(_units(2, 1))
    assert schedule.take(None, False) == ("0", CLEAN, 0)
    assert schedule.take(None, False) == ("1", CLEAN, 0)
    assert [schedule.take("0", False) for _ in range(3)] == [("0", "c0", severity) for severity in (1, 2, 4)]
    assert schedule.take("0", False) is None, "only the other feeder may work on sample 1 until its clean flow exists"
    schedule.finish(("1", CLEAN, 0), {}, {})
    assert schedule.take("0", False) == ("1", "c0", 1)

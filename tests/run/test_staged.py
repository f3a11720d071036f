"""Models on accelerators: one process predicts while other processes corrupt and measure, and the rows are
unchanged."""

import multiprocessing
import threading

import pytest

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelSpec
from robustflow.run.engines.base import Job
from robustflow.run.engines.feeder import SharedSlots, _Feeder, cells_ahead
from robustflow.run.plan import RunOptions
from robustflow.testing import TexturePairs

from .conftest import FAST
from .models_for_tests import Accelerated, Sizes

KEYS = ("0", "1", "2")


def _model(**options):
    return ModelSpec("tests.run.models_for_tests:Accelerated", tuple(options.items()))


def _run(output, model, **options):
    return rf.evaluate(model, Benchmark("drawn", Sizes(3), KEYS, FAST, (1, 4)), output=output, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return _run(tmp_path_factory.mktemp("whole") / "run", _model(), engine="serial")


def _predictions(log):
    """The process, device and number of pairs of every call."""
    return [(pid, device, int(pairs)) for pid, device, pairs in map(str.split, log.read_text().splitlines())]


def test_rows_are_those_of_one_process(whole, tmp_path, quick_workers, monkeypatch):
    """A run on two devices, one of which has two feeders."""
    monkeypatch.setenv("PREDICTION_LOG", str(tmp_path / "log"))
    staged = _run(tmp_path / "run", _model(device="cuda:0,cuda:1"), workers=3)
    assert staged.rows.equals(whole.rows)
    assert (staged.path / "summary.json").read_bytes() == (whole.path / "summary.json").read_bytes()
    assert not list((staged.path / "clean").iterdir())
    calls = _predictions(tmp_path / "log")
    assert len(calls) == whole.rows.height, "each clean flow is predicted only once"
    placed = {(pid, device) for pid, device, _ in calls}
    assert len({pid for pid, _ in placed}) == len({on for _, on in placed}) == len(placed)
    assert {on for _, on in placed} == {"cuda:0", "cuda:1"}
    assert staged.manifest.seconds.keys() == whole.manifest.seconds.keys()


def test_feeders_that_wait_for_the_clean_flow_of_the_only_sample_help_afterwards(tmp_path, quick_workers):
    only = Benchmark("drawn", Sizes(3), KEYS[:1], FAST, (1, 2, 3, 4, 5))
    staged = rf.evaluate(_model(), only, output=tmp_path / "run", workers=3)
    assert staged.rows.equals(rf.evaluate(_model(), only, output=tmp_path / "serial", engine="serial").rows)


def test_batches_are_filled_across_corruptions(whole, tmp_path, quick_workers, monkeypatch):
    monkeypatch.setenv("PREDICTION_LOG", str(tmp_path / "log"))
    staged = _run(tmp_path / "run", _model(), workers=1, batch_size=3)
    assert [pairs for *_, pairs in _predictions(tmp_path / "log")] == 3 * [1, 3, 3, 2]
    assert staged.rows.equals(whole.rows)


def test_a_feeder_makes_no_more_than_its_slots_hold(tmp_path):
    """The device never responds, so the feeder stops when its slots are full; larger frames get fewer slots."""
    size = (700, 1000)
    driver, feeder_end = multiprocessing.Pipe()
    device, link = multiprocessing.Pipe()
    slots = SharedSlots(4)
    feeder = _Feeder(feeder_end, Job(TexturePairs(1, size), ModelSpec("none"), RunOptions(), tmp_path), link, slots)
    (tmp_path / "clean").mkdir()
    ended = threading.Event()

    def live():
        try:
            while True:
                feeder.step()
        except EOFError:
            ended.set()

    threading.Thread(target=live, daemon=True).start()
    cells = iter([("0", "clean", 0), *(("0", "contrast", 1 + number % 5) for number in range(300))])
    for _ in range(cells_ahead(1)):
        driver.send(("cell", next(cells)))
    requests, made = [], 0
    while driver.poll(60 if made < max(1, slots.count) else 0.5) or device.poll():
        if driver.poll():
            kind, _ = driver.recv()
            assert kind == "made"
            made += 1
            driver.send(("cell", next(cells)))
        while device.poll():
            requests += device.recv()
    assert made == len(requests) == slots.count == 128 * 2**20 // slots.slot_bytes
    assert slots.free == 0
    assert requests[0].cell == ("0", "clean", 0)
    slots.flow(requests[0].slot, requests[0].slot_bytes, (*size, 2))[:] = 0
    device.send(0.01)
    assert driver.poll(60)
    assert driver.recv()[0] == "row"
    assert driver.poll(60)
    assert driver.recv()[0] == "made", "a released slot is reused"
    driver.close()
    assert ended.wait(20)
    slots.close()


def test_a_model_object_on_a_device_is_sent_there(tmp_path, quick_workers):
    assert _run(tmp_path / "run", Accelerated("gpu:3"), workers=1).rows.height == 27

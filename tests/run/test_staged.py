"""Models on accelerators: one process predicts while others corrupt and measure, and the rows are unchanged."""

import multiprocessing
import threading
from contextlib import suppress

import numpy as np
import pytest

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.metrics.rows import CLEAN
from robustflow.models import ModelSpec
from robustflow.run.engines.base import Job
from robustflow.run.engines.device import BATCHES_PER_FEEDER, Feeder, SharedBatch
from robustflow.run.plan import RunOptions, Unit
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
    pairs = [pairs for *_, pairs in _predictions(tmp_path / "log")]
    assert sum(pairs) == whole.rows.height
    assert max(pairs) == 3, "a unit has two cells"
    assert pairs.count(1) >= len(KEYS), "a clean flow is predicted alone"
    assert staged.rows.equals(whole.rows)


def test_a_feeder_prepares_no_more_than_its_batches_hold(tmp_path):
    """The device does not respond, so the feeder stops; it continues when a batch is returned."""
    size = (60, 80)
    driver, feeder_end = multiprocessing.Pipe()
    device, link = multiprocessing.Pipe()
    batches = [SharedBatch() for _ in range(BATCHES_PER_FEEDER)]
    feeder = Feeder(feeder_end, Job(TexturePairs(1, size), ModelSpec("none"), RunOptions(), tmp_path), link, batches)
    (tmp_path / "clean").mkdir()
    for unit in (Unit("0", CLEAN, (0,)), *(Unit("0", name, (1, 2, 3)) for name in FAST)):
        driver.send(unit)
    ended = threading.Event()

    def live():
        with suppress(EOFError):
            while True:
                feeder.step()
        ended.set()

    threading.Thread(target=live, daemon=True).start()
    sent = []
    while device.poll(60 if len(sent) < BATCHES_PER_FEEDER - 1 else 0.5):
        sent.append(device.recv())
    cells = [shared.request.cell for _, requests in sent for shared in requests]
    assert cells == [("0", CLEAN, 0), ("0", FAST[0], 1), ("0", FAST[1], 1)], "one of each corruption in turn"
    index, (clean,) = sent[0]
    batches[index].array(clean.begin, (*size, 2), np.float32)[:] = 0
    device.send(0.01)
    assert device.poll(60)
    messages = [driver.recv() for _ in range(5)]
    assert [value[0] for kind, value in messages if kind == "rows"] == [Unit("0", CLEAN, (0,))]
    driver.close()
    assert ended.wait(20)


def test_a_model_object_on_a_device_is_sent_there(tmp_path, quick_workers):
    assert _run(tmp_path / "run", Accelerated("gpu:3"), workers=1).rows.height == 27


def test_an_array_outlives_the_enlargement_of_its_memory():
    batch = SharedBatch()
    batch.reserve(4096)
    small = batch.array(0, (4096,), np.uint8)
    small[:] = 5
    batch.reserve(10**6)
    batch.array(4096, (10**6 - 4096,), np.uint8)[:] = 7
    assert (small == 5).all()
    assert (batch.array(0, (4096,), np.uint8) == 5).all()
    batch.close()

"""Models on accelerators: one process predicts while others corrupt and measure, and the rows are unchanged."""

import pytest

import robustflow as rf
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelSpec

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


def test_a_model_object_on_a_device_is_sent_there(tmp_path, quick_workers):
    assert _run(tmp_path / "run", Accelerated("gpu:3"), workers=1).rows.height == 27

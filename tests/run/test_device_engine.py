"""Models on accelerators: one process predicts while others corrupt and measure. The rows are unchanged, failing
processes are named, and a killed driver leaves no process behind."""

import os
import signal
from functools import partial
from pathlib import Path

import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, RunError
from robustflow.data.benchmarks import Benchmark
from robustflow.models import ModelRef
from robustflow.testing import TexturePairs

from ..refusals import refusal
from .conftest import FAST
from .models_for_tests import Accelerated, KillsItsReader, Sizes
from .processes import descendants, finished, rows_so_far, start_run, wait_until

KEYS = ("0", "1", "2")


def _model(**options):
    return ModelRef.parse("tests.run.models_for_tests:Accelerated", tuple(options.items()))


def _run(output, model, **options):
    return rf.evaluate(model, Benchmark("drawn", Sizes(3), KEYS, FAST, (1, 4)), output=output, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return _run(tmp_path_factory.mktemp("whole") / "run", _model(), engine="serial")


def _predictions(log):
    """The process, device and number of pairs of every call."""
    return [(pid, device, int(pairs)) for pid, device, pairs in map(str.split, log.read_text().splitlines())]


def test_rows_are_those_of_one_process(whole, tmp_path, monkeypatch):
    """A run on two devices, one of which has two feeders."""
    monkeypatch.setenv("PREDICTION_LOG", str(tmp_path / "log"))
    staged = _run(tmp_path / "run", _model(device="cuda:0,cuda:1"), workers=3)
    assert staged.rows.equals(whole.rows)
    assert (staged.path / "summary.json").read_bytes() == (whole.path / "summary.json").read_bytes()
    calls = _predictions(tmp_path / "log")
    assert len(calls) == whole.rows.height + 1, "only the first clean flow is predicted twice"
    placed = {(pid, device) for pid, device, _ in calls}
    assert len({pid for pid, _ in placed}) == len({on for _, on in placed}) == len(placed)
    assert {on for _, on in placed} == {"cuda:0", "cuda:1"}
    assert staged.manifest.seconds.keys() == whole.manifest.seconds.keys()


def test_feeders_that_wait_for_the_clean_flow_of_the_only_sample_help_afterwards(tmp_path):
    only = Benchmark("drawn", Sizes(3), KEYS[:1], FAST, (1, 2, 3, 4, 5))
    staged = rf.evaluate(_model(), only, output=tmp_path / "run", workers=3)
    assert staged.rows.equals(rf.evaluate(_model(), only, output=tmp_path / "serial", engine="serial").rows)


def test_batches_are_filled_across_corruptions(whole, tmp_path, monkeypatch):
    monkeypatch.setenv("PREDICTION_LOG", str(tmp_path / "log"))
    staged = _run(tmp_path / "run", _model(), workers=1, batch_size=3)
    pairs = [pairs for *_, pairs in _predictions(tmp_path / "log")]
    assert sum(pairs) == whole.rows.height + 1, "the first clean flow is predicted twice"
    assert max(pairs) == 3, "a unit has two cells"
    assert pairs.count(1) >= len(KEYS), "a clean flow is predicted alone"
    assert staged.rows.equals(whole.rows)


def test_a_model_object_on_a_device_is_sent_there(tmp_path):
    assert _run(tmp_path / "run", Accelerated("gpu:3"), workers=1).rows.height == 27


@pytest.mark.parametrize(
    ("trouble", "error", "fact"),
    [
        ("nan", ModelError, " 1 "),
        ("raises", ModelError, "ValueError: no weights"),
        ("hangs", ModelError, " 1.5 "),
        ("dies", RunError, "17"),
        ("crashes", RunError, "model tests.run.models_for_tests:Trouble"),
    ],
)
def test_failing_prediction_process_ends_the_run(tmp_path, trouble, error, fact):
    options = (("trouble", trouble), ("after", 1), ("device", "cuda:0"))
    model = ModelRef.parse("tests.run.models_for_tests:Trouble", options)
    benchmark = Benchmark("drawn", TexturePairs(1, (24, 32)), ("0",), ("contrast",), (4,))
    timeout = 1.5 if trouble == "hangs" else None
    run = partial(rf.evaluate, model, benchmark, output=tmp_path / "run", workers=1, timeout=timeout)
    assert fact in str(refusal(run, error, "sample '0', contrast severity 4"))


def test_a_feeder_that_dies_is_named(tmp_path):
    benchmark = Benchmark("drawn", KillsItsReader(2, (24, 32)), ("0", "1"), ("contrast",), (1,))
    model = ModelRef.parse("tests.run.models_for_tests:Accelerated")
    run = partial(rf.evaluate, model, benchmark, output=tmp_path / "run", workers=1)
    assert "18" in str(refusal(run, RunError, "sample '1', clean"))


def _start(folder, *options, **environment):
    fixed = ["-O", "after=1", "--device", "cuda:0", "--corruptions", ",".join(FAST), "--workers", "2", "--no-examples"]
    return start_run(folder, "Trouble", *fixed, *options, **environment)


@pytest.mark.parametrize("trouble", [pytest.param("", marks=pytest.mark.slow), "hangs"])
def test_a_killed_driver_leaves_no_process_and_no_memory_and_the_run_continues(tmp_path, trouble):
    """No process is left even if the model hangs and its process never reads from its pipe again."""
    before = set(os.listdir("/dev/shm"))
    log = tmp_path / "log"
    run = _start(tmp_path / "run", "-O", f"trouble={trouble or 'none'}", "-O", "pause=0.1", PREDICTION_LOG=str(log))
    wait_until(lambda: log.exists() and (trouble or len(log.read_text().splitlines()) > 7))
    children = descendants(run.pid)
    assert len(children) >= 3
    made = set(os.listdir("/dev/shm")) - before
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), within_s=20)
    # a few may belong to tests that run at the same time
    wait_until(lambda: not made & set(os.listdir("/dev/shm")), within_s=20)
    if trouble:
        return
    again = _start(tmp_path / "run", "-O", "trouble=none", "-O", "pause=0.1", PREDICTION_LOG=str(log))
    finished(again)
    whole = _start(tmp_path / "whole", "-O", "trouble=none", "-O", "pause=0.1", "--engine", "processes")
    finished(whole)
    assert rows_so_far(tmp_path / "run").equals(rows_so_far(tmp_path / "whole"))

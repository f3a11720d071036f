"""A failing predictor or feeder process ends the run with a clear message; a killed driver leaves no process behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import robustflow as rf
from robustflow.benchmarks import Benchmark
from robustflow.errors import ModelError, RunError
from robustflow.models import ModelSpec
from robustflow.runs.store import RunFolder
from robustflow.testing import TexturePairs

from .conftest import FAST


def _trouble(tmp_path, trouble, **options):
    model = ModelSpec("models_for_tests:AcceleratedTrouble", (("trouble", trouble),))
    benchmark = Benchmark("drawn", TexturePairs(1, (24, 32)), ("0",), FAST, (1, 4))
    return rf.evaluate(model, benchmark, output=tmp_path / "run", workers=1, **options)


@pytest.mark.parametrize(
    ("trouble", "says"),
    [
        ("nan", r"1 pixels that are NaN or infinite on sample '0', \w+ severity \d"),
        ("raises", r"raised ValueError on sample '0', \w+ severity \d: no weights"),
    ],
)
def test_an_answer_that_is_not_a_flow(tmp_path, models_on_path, trouble, says):
    with pytest.raises(ModelError, match=says):
        _trouble(tmp_path, trouble)


def test_a_prediction_that_hangs_is_stopped(tmp_path, models_on_path):
    with pytest.raises(ModelError, match=r"longer than 1\.5 s on sample '0', \w+ severity \d"):
        _trouble(tmp_path, "hangs", timeout=1.5)


def test_a_predicting_process_that_dies_is_named(tmp_path, models_on_path):
    with pytest.raises(RunError, match=r"exit code 17\) while computing sample '0', \w+ severity \d"):
        _trouble(tmp_path, "dies")


def test_a_feeder_that_dies_is_named(tmp_path, models_on_path):
    dataset = __import__("models_for_tests").KillsItsReader(2, (24, 32))
    benchmark = Benchmark("drawn", dataset, ("0", "1"), ("contrast",), (1,))
    model = ModelSpec("models_for_tests:Accelerated")
    with pytest.raises(RunError, match=r"exit code 18\) while computing sample '1', clean"):
        rf.evaluate(model, benchmark, output=tmp_path / "run", workers=1)


def _start(folder, *options, **environment):
    model = ["--model", "models_for_tests:AcceleratedTrouble", *options]
    arguments = ["--corruptions", ",".join(FAST), "--output", str(folder), "--workers", "2", "--no-examples"]
    return subprocess.Popen(
        [sys.executable, "-c", "from robustflow.cli.main import main; main()", "run", *model, *arguments],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent), **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def _children(pid):
    """The child processes of a process."""
    below = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == pid:
                below += [int(entry.name), *_children(int(entry.name))]
    return below


def _wait(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("trouble", [pytest.param("", marks=pytest.mark.slow), "hangs"])
def test_a_killed_driver_leaves_no_process_and_no_memory_and_the_run_continues(tmp_path, trouble):
    """No process is left even if the model hangs and its process never reads from its pipe again."""
    before = set(os.listdir("/dev/shm"))
    log = tmp_path / "log"
    run = _start(tmp_path / "run", "-O", f"trouble={trouble or 'none'}", "-O", "pause=0.1", PREDICTION_LOG=str(log))
    _wait(lambda: log.exists() and (trouble or len(log.read_text().splitlines()) > 7))
    children = _children(run.pid)
    assert len(children) >= 3
    made = set(os.listdir("/dev/shm")) - before
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    _wait(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), 20)
    _wait(lambda: not made & set(os.listdir("/dev/shm")), 20)  # a few may belong to tests that run at the same time
    if trouble:
        return
    again = _start(tmp_path / "run", "-O", "trouble=none", "-O", "pause=0.1", PREDICTION_LOG=str(log))
    assert again.wait(120) == 0, again.stderr.read().decode()
    whole = _start(tmp_path / "whole", "-O", "trouble=none", "-O", "pause=0.1", "--engine", "processes")
    assert whole.wait(120) == 0, whole.stderr.read().decode()
    assert RunFolder(tmp_path / "run").rows().equals(RunFolder(tmp_path / "whole").rows())


@pytest.mark.slow
def test_an_interrupted_run_says_what_is_kept(tmp_path):
    log = tmp_path / "log"
    run = _start(tmp_path / "run", "-O", "pause=0.2", PREDICTION_LOG=str(log))
    _wait(log.exists)
    children = _children(run.pid)
    run.send_signal(signal.SIGTERM)
    assert run.wait(20) == 130
    assert f"kept in {tmp_path / 'run'}. Run the same command again to continue." in run.stderr.read().decode()
    _wait(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), 20)

"""Processes that start before their run, serve several, and run errands."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import contextmanager

import pytest
from typer.testing import CliRunner

import robustflow as rf
from robustflow.cli.main import app
from robustflow.errors import RunError, UsageError
from robustflow.models import load_model, registry
from robustflow.runner.engines import worker_process as module
from robustflow.runner.engines.worker_process import errand, kept_processes, release

CELLS = {"corruptions": ["contrast", "gaussian_noise"], "severities": [1, 2]}


@pytest.fixture(autouse=True)
def two_processors(monkeypatch):
    monkeypatch.setattr(module, "available_processors", lambda: 2)


def _pids() -> list[int]:
    return [child._process.pid for child in module._idle]


def _gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def only_elsewhere(here: int) -> int:
    if os.getpid() == here:
        raise ValueError("called here")
    return os.getpid()


def only_here(here: int) -> int:
    if os.getpid() != here:
        raise ValueError("called elsewhere")
    return here


def end_elsewhere(here: int) -> int:
    if os.getpid() != here:
        os._exit(3)
    return here


def test_processes_serve_one_run_after_another_with_the_rows_of_one_process(tmp_path):
    with kept_processes(early=True):
        before = _pids()
        for model in ("dis", "farneback"):
            run = rf.evaluate(model, output=tmp_path / model, engine="processes", workers=2, **CELLS)
            alone = rf.evaluate(model, output=tmp_path / f"{model} alone", engine="serial", **CELLS)
            assert run.rows.equals(alone.rows)
            assert sorted(_pids()) == sorted(before), "the same processes wait again"
    assert len(before) == 2
    assert all(_gone(pid) for pid in before)


def test_without_such_a_block_nothing_is_left(tmp_path):
    rf.evaluate("farneback", output=tmp_path, engine="processes", workers=2, **CELLS)
    assert module._idle is None


def test_an_errand_is_run_elsewhere_and_its_process_waits_again():
    with kept_processes(early=True):
        pids = _pids()
        result = errand(only_elsewhere, os.getpid())
        assert len(module._idle) == 1
        assert result() in pids
        assert sorted(_pids()) == sorted(pids)


@pytest.mark.parametrize("function", [only_here, end_elsewhere])
def test_an_errand_that_fails_elsewhere_is_run_here(function):
    with kept_processes(early=True):
        assert errand(function, os.getpid())() == os.getpid()
        assert len(module._idle) == 1, "that process is not used again"


def test_an_errand_that_nobody_asks_about_ends_with_the_block():
    with kept_processes(early=True):
        pids = _pids()
        errand(time.sleep, 600)
    assert all(_gone(pid) for pid in pids)


def test_an_errand_without_a_process_is_run_here_when_its_result_is_asked_for():
    with kept_processes(early=False):
        result = errand(only_elsewhere, os.getpid())
        with pytest.raises(ValueError, match="called here"):
            result()


def test_processes_end_with_the_block_however_it_ends():
    pids = []

    def stopped():
        with kept_processes(early=True):
            pids.extend(_pids())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert len(pids) == 2
    assert all(_gone(pid) for pid in pids)


def test_a_process_with_work_left_is_not_kept():
    with kept_processes(early=True):
        child = module._idle.pop()
        release(child, idle=False)
        assert len(module._idle) == 1
        assert _gone(child._process.pid)


def test_a_process_that_died_early_is_an_error_that_says_so(tmp_path):
    with kept_processes(early=True):
        for pid in _pids():
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.2)
        with pytest.raises(RunError, match="ended without a message"):
            rf.evaluate("farneback", output=tmp_path / "run", engine="processes", workers=2, **CELLS)


@pytest.mark.parametrize("name", ["dis", "dis_rgb", "farneback", "tiny", "tiny_all", "precomputed", "raft"])
def test_models_known_to_use_one_thread_do(name, monkeypatch):
    monkeypatch.setattr(registry, "find_spec", lambda name: None)
    known = registry.known_single_threaded(name)
    assert known == (name not in ("precomputed", "raft"))
    if known:
        options = {"runtime": "numpy"} if name.startswith("tiny") else {}
        assert load_model(name, **options).single_threaded is True


def test_with_pytorch_the_small_network_does_not(monkeypatch):
    monkeypatch.setattr(registry, "find_spec", lambda name: name)
    assert not registry.known_single_threaded("tiny")


@pytest.mark.parametrize(
    ("options", "early"),
    [
        (["-m", "dis"], True),
        (["-m", "farneback", "-m", "precomputed"], True),
        (["-m", "precomputed"], False),
        (["-m", "dis", "-c", "fog"], False),
        (["-m", "dis", "-s", "3"], False),
        (["-m", "dis", "--limit", "1"], False),
        (["-m", "dis", "--engine", "serial"], False),
        (["-m", "dis", "--workers", "1"], False),
    ],
)
def test_only_a_whole_run_whose_engine_is_left_to_choice_starts_them_early(monkeypatch, options, early):
    asked = []

    @contextmanager
    def noted(early):
        asked.append(early)
        raise UsageError("enough")
        yield

    monkeypatch.setattr(module, "kept_processes", noted)
    CliRunner().invoke(app, ["run", *options])
    assert asked == [early]


def seen_there(name: str) -> tuple[str | None, list[str]]:
    return os.environ.get(name), sys.path


def test_a_process_that_started_early_finds_what_was_set_since(monkeypatch, tmp_path):
    monkeypatch.setenv("ROBUSTFLOW_TEST_GONE", "before")
    with kept_processes(early=True):
        monkeypatch.setenv("ROBUSTFLOW_TEST", "since")
        monkeypatch.delenv("ROBUSTFLOW_TEST_GONE")
        monkeypatch.syspath_prepend(str(tmp_path))
        value, path = errand(seen_there, "ROBUSTFLOW_TEST")()
        assert value == "since"
        assert str(tmp_path) in path
        assert errand(seen_there, "ROBUSTFLOW_TEST_GONE")()[0] is None

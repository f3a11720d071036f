"""A run killed without warning loses only the unit in flight; killed at any write and started again, it has the same
rows and files as an undisturbed run."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from robustflow.run.store import RunFolder, list_shards, shard_name

from . import killed_at_each_write as script
from .conftest import FAST
from .processes import check_stopped_by_ctrl_c, start_run, wait_until

WORKERS = 2


def _start(folder: Path, log: Path, frames: Path) -> subprocess.Popen[str]:
    options = ["-O", "shape=48x64", "-O", "pause=0.1", "--corruptions", ",".join(FAST), "--workers", str(WORKERS)]
    options += ["--benchmark", "folder", "--data", str(frames), "--limit", "2"]
    return start_run(folder, "Logged", *options, PREDICTION_LOG=str(log))


def test_interrupted_run_says_how_to_continue(tmp_path, clip_folder):
    run = _start(tmp_path / "run", tmp_path / "log", clip_folder)
    wait_until((tmp_path / "log").exists, run)
    run.send_signal(signal.SIGTERM)
    assert run.wait(20) == 130


_SLOW = pytest.mark.slow


@pytest.mark.parametrize("delay", [0.0, *(pytest.param(delay, marks=_SLOW) for delay in (0.15, 0.6, 1.2))])
def test_ctrl_c_while_workers_start_prints_one_line(tmp_path, delay):
    """Only one of the processes prints a message, even while others are still importing."""
    check_stopped_by_ctrl_c(start_run(tmp_path / "run", "Logged", "--workers", "2", PREDICTION_LOG=os.devnull), delay)


@pytest.mark.slow
def test_run_killed_at_every_write_resumes_to_the_same_rows(tmp_path):
    whole = script.run(tmp_path / "whole").rows
    assert whole.height == 15
    subprocess.run([sys.executable, script.__file__, tmp_path], check=True, env=os.environ)
    killed = [path for path in tmp_path.iterdir() if path.name != "whole"]
    assert len(killed) > 60
    undone = 0
    for folder in killed:
        undone += not (folder / "summary.json").exists()
        run = script.run(folder)
        assert run.rows.equals(whole), folder.name
        assert run.measured.complete
        assert [shard_name(path) for path in list_shards(folder / "rows")] == ["pack"], folder.name
        assert not (folder / "clean").exists(), folder.name
        assert not list(folder.rglob(".partial-*")), folder.name
        assert RunFolder(folder).tidy() == set(whole.select("sample", "corruption", "severity").iter_rows())
    assert undone > len(killed) / 2

"""A run killed without warning loses only the unit in flight; killed at any write and started again, it has the same
rows and files as an undisturbed run."""

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from robustflow.run.store import RunFolder, list_shards, shard_name

from . import killed_at_each_write as script
from .conftest import FAST
from .processes import check_stopped_by_ctrl_c, finished, rows_so_far, start_run, wait_until

WORKERS = 2


def _start(folder: Path, log: Path, frames: Path) -> subprocess.Popen[str]:
    options = ["-O", "shape=48x64", "-O", "pause=0.1", "--corruptions", ",".join(FAST), "--workers", str(WORKERS)]
    options += ["--benchmark", "folder", "--data", str(frames), "--limit", "2"]
    return start_run(folder, "Logged", *options, PREDICTION_LOG=str(log))


@pytest.mark.slow
def test_run_killed_at_ten_moments_resumes_to_the_same_rows(tmp_path, clip_folder):
    kills = 10
    undisturbed = _start(tmp_path / "whole", tmp_path / "whole.log", clip_folder)
    started = time.monotonic()
    finished(undisturbed)
    length = time.monotonic() - started

    moments = random.Random(1)
    killed = 0
    while killed < kills:
        run = _start(tmp_path / "killed", tmp_path / "killed.log", clip_folder)
        deadline = time.monotonic() + moments.uniform(0.3, 1.1) * length
        while run.poll() is None and time.monotonic() < deadline:
            rows_so_far(tmp_path / "killed")
            time.sleep(0.1)
        if run.poll() is not None:  # the run finished before it was killed, so check it and start again
            finished(run)
            _compare(tmp_path, killed)
            for path in sorted((tmp_path / "killed").rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            (tmp_path / "killed.log").unlink()
        else:
            os.kill(run.pid, signal.SIGKILL)
            run.wait()
            killed += 1
    last = _start(tmp_path / "killed", tmp_path / "killed.log", clip_folder)
    finished(last)
    _compare(tmp_path, kills)


def _compare(tmp_path: Path, kills: int) -> None:
    assert rows_so_far(tmp_path / "killed").equals(rows_so_far(tmp_path / "whole"))
    assert (tmp_path / "killed/summary.json").read_bytes() == (tmp_path / "whole/summary.json").read_bytes()
    asked = Counter(line.split(" ", 1)[1] for line in (tmp_path / "killed.log").read_text().splitlines())
    again = sum(asked.values()) - len(asked)
    in_flight = 5  # each worker has one unit in flight, with this many severities
    drawn = 3  # the clean, worst and median cells are predicted again for the images
    compared = 1 + WORKERS  # clean rows are measured again: the first one, and those of the samples in progress
    assert again <= kills * (WORKERS * in_flight + drawn + compared) + drawn
    pictures = {path.name: path.read_bytes() for path in (tmp_path / "killed/examples").iterdir()}
    assert pictures == {path.name: path.read_bytes() for path in (tmp_path / "whole/examples").iterdir()}
    assert not list((tmp_path / "killed").rglob(".partial-*"))


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

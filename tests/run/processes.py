"""Runs started from the command line, as a terminal starts them, and the processes that they start."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import polars as pl

from robustflow.run.store import RunFolder


def start_run(folder: Path, model: str, *options: str, **environment: str) -> subprocess.Popen[str]:
    """Start `robustflow run` with a model of `models_for_tests`, in its own process group."""
    model = f"tests.run.models_for_tests:{model}"
    command = [sys.executable, "-c", "from robustflow.cli.main import main; main()", "run", "--model", model]
    return subprocess.Popen(
        [*command, "--output", str(folder), *options],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_hears_ctrl_c,
    )


def _hears_ctrl_c() -> None:
    """Enable Ctrl-C even if the tests run in the background, where the signal is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def finished(run: subprocess.Popen[str]) -> None:
    _, err = run.communicate(timeout=120)
    assert run.returncode == 0, err


def wait_until(condition: Callable[[], object], run: subprocess.Popen[str] | None = None, within_s: float = 60) -> None:
    """Wait for a condition, and fail if it takes too long or the run that should fulfil it has ended."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert run is None or run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def rows_so_far(folder: Path) -> pl.DataFrame:
    """The rows of a run, which can be read at any time, because shards are either complete or absent."""
    return RunFolder(folder).rows() if folder.exists() else pl.DataFrame()


def check_stopped_by_ctrl_c(run: subprocess.Popen[str], delay: float) -> None:
    """Ctrl-C, which reaches every process of a terminal, ends the run with one line."""
    first = run.stderr.readline()
    assert "steps" in first
    time.sleep(delay)
    os.killpg(run.pid, signal.SIGINT)
    printed, errors = run.communicate(timeout=60)
    assert run.returncode == 130, errors
    assert printed == ""
    lines = [line for line in errors.splitlines() if " s left, last " not in line]
    assert len(lines) == 1, errors
    assert lines[0].startswith("robustflow: stopped; ")


def descendants(root: int) -> dict[int, str]:
    parents, lines = {}, {}
    for folder in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            lines[int(folder.name)] = _command(folder)
    found, before = {root}, set()
    while found != before:
        before = set(found)
        found |= {child for child, parent in parents.items() if parent in before}
    return {number: lines[number] for number in found - {root} if number in lines}


def is_running(number: int) -> bool:
    """Whether a process exists; one that has ended may wait for a parent that asks how."""
    with suppress(OSError):
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def still_running(mark: str, within_s: float = 20.0) -> list[str]:
    """Process IDs and command lines of the processes that contain `mark` and are still running after a while."""
    deadline = time.monotonic() + within_s
    while (left := running(mark)) and time.monotonic() < deadline:
        time.sleep(0.2)
    return left


def running(mark: str) -> list[str]:
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            with suppress(OSError):
                if mark in (line := _command(folder)):
                    found.append(f"{folder.name} {line[:200]}")
    return found


def _command(folder: Path) -> str:
    return (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")

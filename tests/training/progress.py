"""Start training runs in processes, stop them after a number of updates, and read the files that they write."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="needs the torch extra")

_SCRIPT = """
import itertools, os, pickle, sys
from robustflow.training.session import run_training
if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        run_training(pickle.load(file)STOP)
"""
ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1"}


def weights(path: Path) -> dict[str, torch.Tensor]:
    return torch.load(path, weights_only=True)["model"]


def lines(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def assert_same_training(one: Path, other: Path) -> None:
    """The runs in both folders have the same final weights and, except for the times, the same log."""
    first, second = weights(one / "last.pth"), weights(other / "last.pth")
    assert first.keys() == second.keys()
    assert [key for key in first if not torch.equal(first[key], second[key])] == []
    assert [{**line, "seconds": 0} for line in lines(one)] == [{**line, "seconds": 0} for line in lines(other)]


class StopAfter:
    """Requests a stop after the given number of updates."""

    def __init__(self, updates: int) -> None:
        self.left = updates

    def __call__(self) -> bool:
        self.left -= 1
        return self.left <= 0


def training_command(request: Any, folder: Path, *launcher: str, stop: str = "") -> list[str]:
    """A command that runs the request in a process; its script is written to the folder.

    Args:
        launcher: options of Python that start the script.
        stop: source code of the stop function.
    """
    script, saved = folder / "it.py", folder / "request.pkl"
    script.write_text(_SCRIPT.replace("STOP", stop and f", {stop}"))
    saved.write_bytes(pickle.dumps(request))
    return [sys.executable, *launcher, str(script), str(saved)]


def train_in_two_processes(request: Any, folder: Path, stop: str = "", timeout: float = 300) -> None:
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")
    command = training_command(request, folder, *launcher, stop=stop)
    done = subprocess.run(command, capture_output=True, text=True, env=ONE_THREAD, timeout=timeout)
    assert done.returncode == 0, done.stderr[-2000:]

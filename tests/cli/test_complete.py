"""Completion in the shell, asked for as a shell asks."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_MAIN = "import sys; sys.argv = ['robustflow']; from robustflow.cli.main import main; main()"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("robustflow verif", {"verify"}),
        ("robustflow run --model farne", {"farneback"}),
        ("robustflow run --corruptions fog,fro", {"fog,frost"}),
        ("robustflow corrupt a.png b.png -c fog+sno", {"fog+snow"}),
        ("robustflow run --benchmark kitti", {"kitti-fc"}),
    ],
)
def test_a_tab_in_bash(typed, offered):
    words = typed.split()
    asked = {"_ROBUSTFLOW_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(words) - 1)}
    answer = subprocess.run(
        [sys.executable, "-c", _MAIN], env={**os.environ, **asked}, capture_output=True, text=True, timeout=60
    )
    assert answer.stderr == ""
    assert offered <= set(answer.stdout.split())
    assert all(word.startswith(words[-1]) for word in answer.stdout.split())

"""Run the command line in this process, and two finished runs for it to read."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.api import evaluate
from robustflow.cli.main import main


class CommandLine:
    """The command line; calling it returns (exit code, stdout, stderr)."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        self._monkeypatch.setattr(sys, "argv", ["robustflow", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = self._capsys.readouterr()
        return code, captured.out, captured.err

    def prints(self, *arguments: object) -> str:
        """Return the output of a command that succeeds."""
        code, out, error = self(*arguments)
        assert code == 0, error
        return out

    def refuses(self, *arguments: object, code: int = 2) -> str:
        """Return the message of a command that is refused in one line with this exit code; a run may have announced
        its size before."""
        got, _, error = self(*arguments)
        *before, message = error.splitlines()
        assert got == code, error
        assert message.startswith("robustflow: ")
        assert all("; engine: " in line for line in before), error
        return message


@pytest.fixture
def robustflow(monkeypatch, capsys, tmp_path) -> CommandLine:
    """The command line in the working folder `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capsys)


@pytest.fixture(scope="session")
def runs(tmp_path_factory) -> list[Path]:
    """The folders of two runs on the embedded pair, by DIS and by Farneback's method; the tests only read them."""
    folder = tmp_path_factory.mktemp("runs")
    options = {"corruptions": ["contrast"], "severities": [1, 5]}
    return [evaluate(model, "demo", output=folder / model, **options).path for model in ("dis", "farneback")]


def write_frames(folder: Path, sizes=((64, 96), (64, 96))) -> list[Path]:
    """Write noise images 000.png, 001.png, ... with the given sizes (height, width); return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = []
    for index, size in enumerate(sizes):
        paths.append(folder / f"{index:03d}.png")
        cv2.imwrite(str(paths[-1]), rng.integers(0, 255, (*size, 3)).astype(np.uint8))
    return paths

"""The command line, called in this process."""

from __future__ import annotations

import sys

import pytest

from robustflow.cli.main import main


@pytest.fixture
def robustflow(monkeypatch, capsys, tmp_path):
    """Run the command line in `tmp_path`; returns (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["robustflow", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call

"""Run the command line in this process."""

import os
import sys
from unittest.mock import patch

import pytest

from robustflow.core.errors import RobustFlowError, options_named

from .refusals import refusal


class CommandLine:
    """The command line; calling it returns (exit code, stdout, stderr)."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        from robustflow.cli.main import main

        self._monkeypatch.setattr(sys, "argv", ["robustflow", *map(str, arguments)])
        try:
            with patch.dict(os.environ):  # a command sets variables for its child processes
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

    def refusal(self, arguments: str, error: type[RobustFlowError], culprit: object) -> None:
        """Expect that a command is refused with this error, whose message is one line."""
        from robustflow.cli.main import command_line

        words = arguments.split()
        with options_named():
            refusal(lambda: command_line(words)(words), error, culprit)

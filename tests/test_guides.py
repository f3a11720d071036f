"""The guides' own examples, run as a reader would."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

import robustflow as rf
from robustflow.cli.main import main

DOCS = Path(__file__).resolve().parent.parent / "docs"


def test_add_your_model(tmp_path, monkeypatch, capsys):
    page = (DOCS / "add-your-model.md").read_text()
    module, script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (command,) = re.findall(r"```\n(robustflow run .*?)\n```", page)
    (tmp_path / "my_model.py").write_text(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    monkeypatch.setattr(sys, "argv", [*shlex.split(command), "--output", "run"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (0, None)
    assert "contrast" in capsys.readouterr().out
    model = rf.Result("run").manifest["identity"]["model"]
    assert model["options"] == {"blur": "2.0"}

    exec(compile(script, "add-your-model.md", "exec"), {})
    assert float(capsys.readouterr().out) > -1

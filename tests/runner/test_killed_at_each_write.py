"""A run that is killed at any write and started again has the same rows and files as an undisturbed run."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from robustflow.runs.shards import list_shards, shard_name
from robustflow.runs.store import RunFolder

SCRIPT = Path(__file__).with_name("killed_at_each_write.py")


@pytest.fixture
def script():
    spec = importlib.util.spec_from_file_location("killed_at_each_write", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _check(tmp_path, script, first, step):
    whole = script.run(tmp_path / "whole").rows
    assert whole.height == 15
    subprocess.run([sys.executable, SCRIPT, tmp_path, str(first), str(step)], check=True, env=os.environ)
    killed = [path for path in tmp_path.iterdir() if path.name != "whole"]
    assert len(killed) > 70 // step
    undone = 0
    for folder in killed:
        undone += not (folder / "summary.json").exists()
        run = script.run(folder)
        assert run.rows.equals(whole), folder.name
        assert run.summary.complete
        assert [shard_name(path) for path in list_shards(folder / "rows")] == ["pack"], folder.name
        assert not list((folder / "clean").iterdir()), folder.name
        assert not list(folder.rglob(".partial-*")), folder.name
        assert RunFolder(folder).tidy() == set(whole.select("sample", "corruption", "severity").iter_rows())
    assert undone > len(killed) / 2


@pytest.mark.slow
def test_killed_at_every_seventh_write(tmp_path, script):
    _check(tmp_path, script, 3, 7)


@pytest.mark.slow
def test_killed_at_every_write(tmp_path, script):
    _check(tmp_path, script, 0, 1)

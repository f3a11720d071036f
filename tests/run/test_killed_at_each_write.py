"""A run that is killed at any write and started again has the same rows and files as an undisturbed run."""

import os
import subprocess
import sys

import pytest

from robustflow.run.shards import list_shards, shard_name
from robustflow.run.store import RunFolder

from . import killed_at_each_write as script


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
        assert not list((folder / "clean").iterdir()), folder.name
        assert not list(folder.rglob(".partial-*")), folder.name
        assert RunFolder(folder).tidy() == set(whole.select("sample", "corruption", "severity").iter_rows())
    assert undone > len(killed) / 2

"""What an earlier version wrote still opens: one run folder, an unfinished one, a record and a summary are kept here.

They were written by version 0.1.0 on row schema 1, before shards had a checksum:
`run --model dis --corruptions contrast,fog,gaussian_noise --severities 1,3`, and one stopped in the middle.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

import robustflow as rf
from robustflow.cli.main import app
from robustflow.errors import RunError
from robustflow.metrics.rows import complete_rows
from robustflow.runs.store import RunFolder

DATA = Path(__file__).parent / "data"


@pytest.fixture
def finished(tmp_path):
    return Path(shutil.copytree(DATA / "finished", tmp_path / "finished"))


@pytest.fixture
def unfinished(tmp_path):
    return Path(shutil.copytree(DATA / "unfinished", tmp_path / "unfinished"))


def _continued(folder, **options):
    """The run, continued; None where this version refuses to, and says what differs."""
    digest = json.loads((folder / "manifest.json").read_text())["identity_digest"]
    try:
        run = rf.evaluate("dis", output=folder, **options)
    except RunError as error:
        if "it differs in: " in str(error):
            return None
        raise
    assert run.manifest["identity_digest"] == digest
    return run


def _numbers(value, where=()):
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _numbers(each, (*where, key))
    elif isinstance(value, list):
        for index, each in enumerate(value):
            yield from _numbers(each, (*where, index))
    else:
        yield where, value


def test_the_means_are_those_of_the_old_summary(finished):
    run = rf.load_run(finished)
    assert (round(run.epe_clean, 2), round(run.cre, 2), round(run.rcre, 2)) == (2.64, 0.68, 1.42)
    before = dict(_numbers(json.loads((DATA / "finished/summary.json").read_text())))
    now = dict(_numbers(run.document()))
    kept = {where: value for where, value in before.items() if isinstance(value, float)}
    assert len(kept) > 200
    assert {where: now.get(where) for where in kept} == kept


def test_an_old_folder_is_shown_and_an_old_record_refused_by_its_version(finished):
    shown = CliRunner().invoke(app, ["show", str(finished)])
    assert shown.exit_code == 0, shown.output
    assert "2.64" in shown.output
    verified = CliRunner().invoke(app, ["verify", str(DATA / "finished.robustflow")])
    assert verified.exit_code == 1
    assert "summary.json is of version None, and this version of robustflow reads 3" in verified.output


def test_an_old_run_is_not_compared_with_a_new_one_and_the_reason_is_said(finished, tmp_path):
    run = rf.evaluate("dis", output=tmp_path / "new", corruptions=["contrast"], severities=[1])
    with pytest.raises(RunError, match="version 1 of the rows"):
        rf.load_run(finished).compare(run)


def test_a_finished_run_is_continued_or_refused_with_a_reason(finished):
    before = complete_rows(RunFolder(finished).rows())
    run = _continued(finished, corruptions=["contrast"], severities=[1, 2, 3])
    if run is None:
        return
    assert run.rows.height == before.height + 1
    assert run.rows.join(before, on=["sample", "corruption", "severity"], how="semi").equals(before)


def test_an_unfinished_run_is_continued_or_refused_with_a_reason(unfinished):
    clean = unfinished / "clean"
    clean.mkdir()
    stem = next((unfinished / "rows").iterdir()).name.split(".")[0]
    np.save(clean / f"{stem}.npy", np.full((500, 741, 2), 99, np.float32))  # one of these lay there, without checksum
    before = complete_rows(RunFolder(unfinished).rows())
    run = _continued(unfinished, corruptions=["contrast", "high_light"], severities=[1, 3])
    if run is None:
        return
    assert run.rows.filter(pl.col("corruption") != "high_light").equals(before)
    assert run.rcre < 10, "the clean flow without a checksum is not believed"
    assert not list(clean.iterdir())

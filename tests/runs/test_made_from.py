"""Means and report are kept while nothing changed, and never believed of other rows."""

from __future__ import annotations

import json

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.report.site import write as site_write
from robustflow.runs import run as run_module
from robustflow.runs.made_from import RECORD, rows_digest
from robustflow.runs.shards import list_shards, read_shard, write_shard
from robustflow.runs.store import RunFolder


def _still(frame1, frame2):
    return np.full((*frame1.shape[:2], 2), 1.0, np.float32)


@pytest.fixture
def folder(tmp_path):
    run = rf.evaluate(_still, output=tmp_path / "run", corruptions=["contrast", "high_light"], severities=[1])
    return run.path


@pytest.fixture
def summaries(monkeypatch):
    """How often means are computed."""
    calls = []
    summarize = run_module.summarize
    monkeypatch.setattr(run_module, "summarize", lambda *a, **k: calls.append(1) or summarize(*a, **k))
    return calls


def test_nothing_is_made_again_while_nothing_changed(folder, summaries):
    files = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}
    again = rf.evaluate(_still, output=folder, corruptions=["contrast", "high_light"], severities=[1])
    assert again.summary == rf.load_run(folder).summarize("image")
    assert len(summaries) == 1, "the one here"
    for name in ("report.html", "summary.json"):
        assert files[folder / name] == ((folder / name).read_bytes(), (folder / name).stat().st_mtime_ns)
    assert files[folder / "manifest.json"][0] == (folder / "manifest.json").read_bytes()


def test_kept_means_are_in_the_order_of_computed_ones(folder, summaries):
    """JSON sorts keys; tables and figures follow the order of a summary, which is the paper's."""
    rf.evaluate(_still, output=folder, corruptions=["snow", "fog", "contrast", "elastic_transform"], severities=[1])
    summaries.clear()
    run = rf.load_run(folder)
    kept, computed = run.summary, run.summarize()
    assert len(summaries) == 1, "the first was kept"
    for part in ("corruptions", "families", "regions"):
        assert list(getattr(kept, part)) == list(getattr(computed, part)), part
    assert list(kept.corruptions) == ["contrast", "high_light", "fog", "snow", "elastic_transform"]
    assert kept == computed


def test_means_of_other_rows_are_not_believed(folder):
    (shard,) = list_shards(folder / "rows")
    rows = read_shard(shard)
    shard.unlink()
    write_shard(folder / "rows", "changed", rows.with_columns(epe_sum=pl.col("epe_sum") * 2))
    before = json.loads((folder / "summary.json").read_text())
    run = rf.load_run(folder)
    assert run.epe_clean == pytest.approx(2 * before["epe_clean"])
    report = (folder / "report.html").read_bytes()
    run.write_summary()
    assert json.loads((folder / "summary.json").read_text())["epe_clean"] == run.epe_clean
    assert (folder / "report.html").read_bytes() != report


def test_a_summary_changed_by_hand_is_not_believed(folder):
    path = folder / "summary.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps({**document, "epe_clean": 0.001}))
    run = rf.load_run(folder)
    assert run.epe_clean == document["epe_clean"]
    run.write_means()
    assert json.loads(path.read_text()) == document


@pytest.mark.parametrize("damage", ["", "[]", "{", '{"summary.json": 3}', "[" * 100_000])
def test_a_damaged_note_costs_time_and_nothing_else(folder, damage):
    before = rf.load_run(folder).summary
    (folder / RECORD).write_text(damage)
    run = rf.load_run(folder)
    assert run.summary == before
    run.write_means()
    assert rf.load_run(folder)._kept_means() == before


def test_a_report_is_written_again_when_what_it_shows_changed(folder, monkeypatch):
    written = []
    monkeypatch.setattr(site_write, "write_bytes", lambda path, data: written.append(path))
    run = rf.load_run(folder)
    run.write_report()
    assert not written
    (folder / "displacement.json").write_text("{}")
    monkeypatch.setattr("robustflow.report.site.content.run_content", lambda run: None)
    monkeypatch.setattr("robustflow.report.site.page.render_site", lambda content: "")
    run.write_report()
    assert written


def test_the_digest_of_rows_is_of_their_content(folder):
    rows = RunFolder(folder).rows()
    assert rows_digest(rows) == rows_digest(pl.concat([rows[:1], rows[1:]]))
    for changed in (
        rows[:-1],
        rows.with_columns(epe_sum=pl.col("epe_sum") * (1 + 2**-52)),
        rows.with_columns(n_valid=pl.lit(None, pl.Int64)),
        rows.with_columns(sample=pl.col("sample") + "x"),
    ):
        assert rows_digest(changed) != rows_digest(rows)

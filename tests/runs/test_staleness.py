"""Stored means and reports are reused while nothing changes, and never used for different rows."""

import json
import shutil
from pathlib import Path

import polars as pl
import pytest

import robustflow as rf
from robustflow import atomic
from robustflow.analysis.exclusion import exclusion_reasons
from robustflow.analysis.uncertainty.of_runs import interval_ends
from robustflow.errors import DataError, RunError
from robustflow.report.site import write as site_write
from robustflow.runs import run as run_module
from robustflow.runs.comparable import sample_set
from robustflow.runs.shards import list_shards
from robustflow.runs.staleness import CACHED_VALUES_FILE, STALENESS_FILE, code_digest, write_made
from robustflow.runs.store import RunFolder
from robustflow.testing import ConstantFlow

from .edited import edit_manifest, edit_rows

pytestmark = pytest.mark.usefixtures("demo_is_small")

MODEL = ConstantFlow(1, 1)


@pytest.fixture(autouse=True)
def _pages(real_pictures):
    with real_pictures():
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory, real_pictures):
    """A finished run with its report page."""
    with real_pictures():
        folder = tmp_path_factory.mktemp("made") / "run"
        return rf.evaluate(MODEL, output=folder, corruptions=["contrast", "high_light"], severities=[1]).path


@pytest.fixture
def folder(made, tmp_path):
    """A copy of the run, to be changed."""
    return shutil.copytree(made, tmp_path / "run")


@pytest.fixture
def summaries(monkeypatch):
    """Count how often means are computed."""
    calls = []
    summarize = run_module.summarize
    monkeypatch.setattr(run_module, "summarize", lambda *a, **k: calls.append(1) or summarize(*a, **k))
    return calls


def test_nothing_is_made_again_while_nothing_changed(folder, summaries):
    files = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}
    again = rf.evaluate(MODEL, output=folder, corruptions=["contrast", "high_light"], severities=[1])
    assert again.summary == rf.load_run(folder).summarize("image")
    assert len(summaries) == 1, "the one here"
    for name in ("report.html", "summary.json"):
        assert files[folder / name] == ((folder / name).read_bytes(), (folder / name).stat().st_mtime_ns)
    assert files[folder / "manifest.json"][0] == (folder / "manifest.json").read_bytes()


def test_kept_means_are_in_the_order_of_computed_ones(folder, summaries):
    """JSON sorts keys; tables and figures follow the paper's order, which the summary uses."""
    names = ["contrast+pixelate", "impulse_noise", "fog", "contrast"]
    rf.evaluate(MODEL, output=folder, corruptions=names, severities=[1])
    summaries.clear()
    run = rf.load_run(folder)
    kept, computed = run.summary, run.summarize()
    assert len(summaries) == 1, "the first one was kept"
    for part in ("corruptions", "families", "regions"):
        assert list(getattr(kept, part)) == list(getattr(computed, part)), part
    assert list(kept.corruptions) == ["contrast", "high_light", "fog", "impulse_noise", "contrast+pixelate"]
    assert kept == computed


def test_means_of_other_rows_are_not_believed(folder):
    edit_rows(folder, lambda rows: rows.with_columns(epe_sum=pl.col("epe_sum") * 2))
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
    _edit_summary(folder)
    run = rf.load_run(folder)
    assert run.epe_clean == document["epe_clean"]
    run.write_means()
    assert json.loads(path.read_text()) == document


@pytest.mark.parametrize("damage", ["", "[]", "{", '{"summary.json": 3}', "[" * 100_000])
def test_a_damaged_note_costs_time_and_nothing_else(folder, damage):
    before = rf.load_run(folder).summary
    (folder / STALENESS_FILE).write_text(damage)
    run = rf.load_run(folder)
    assert run.summary == before
    run.write_means()
    assert rf.load_run(folder)._stored_means() == before


def test_a_report_is_written_again_when_what_it_shows_changed(folder, monkeypatch):
    written = []
    monkeypatch.setattr(site_write, "write_made", lambda *file: written.append(file))
    run = rf.load_run(folder)
    run.write_report()
    assert not written
    (folder / "displacement.json").write_text("{}")
    monkeypatch.setattr("robustflow.report.site.content.run_content", lambda run: None)
    monkeypatch.setattr("robustflow.report.site.page.render_site", lambda content: "")
    run.write_report()
    assert written


def _edit_summary(folder):
    path = folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "epe_clean": 0.001}))


def _edit_rows(folder):
    edit_rows(folder, lambda rows: rows.with_columns(magnitude_sum=pl.lit(0.0), frames_digest=pl.lit("0")))


def _edit_facts(folder):
    path = folder / CACHED_VALUES_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "sample_set": "0", "exclusion reasons": ["a lie"]}))


def _edit_manifest(folder):
    edit_manifest(folder, lambda manifest: {**manifest, "selection": {"corruptions": [], "severities": []}})


def _asked(run):
    """Everything that pages request from a run."""
    return sample_set(run), exclusion_reasons(run), interval_ends(run, beside_published=True), run.summary


def _computed(folder, tmp_path):
    """The same values from a copy without cached files."""
    copy = shutil.copytree(folder, tmp_path / "copy")
    for name in (STALENESS_FILE, CACHED_VALUES_FILE, "summary.json"):
        (copy / name).unlink(missing_ok=True)
    return _asked(rf.load_run(copy))


@pytest.mark.parametrize("edit", [lambda folder: None, _edit_summary, _edit_rows, _edit_facts, _edit_manifest])
def test_what_is_kept_is_what_would_be_computed(folder, tmp_path, edit):
    assert (folder / CACHED_VALUES_FILE).is_file(), "the run's report stored the values"
    edit(folder)
    assert _asked(rf.load_run(folder)) == _computed(folder, tmp_path)


def test_a_run_that_is_kept_is_read_without_a_row(folder, monkeypatch):
    whole = _asked(rf.load_run(folder))
    monkeypatch.setattr(RunFolder, "rows", lambda *_: pytest.fail("rows were read"))
    assert _asked(rf.load_run(folder)) == whole


def test_rows_that_come_while_a_run_is_read_are_not_those_that_were_kept(folder):
    run = rf.load_run(folder)
    assert run.rows.height
    _edit_rows(folder)
    (folder / CACHED_VALUES_FILE).unlink()
    before = exclusion_reasons(run)
    run.keep()
    later = rf.load_run(folder)
    assert not later.has_cached_value("exclusion reasons")
    assert exclusion_reasons(later) != before


def test_means_that_another_process_writes_at_the_same_time_are_not_taken_for_these_rows(folder, monkeypatch):
    earlier = (folder / "summary.json").read_bytes()
    edit_rows(folder, lambda rows: rows.with_columns(epe_sum=pl.col("epe_sum") * 2))
    monkeypatch.setattr(
        "robustflow.runs.staleness.write_bytes", lambda path, data: atomic.write_bytes(path, earlier)
    )  # the other process replaces the file as soon as it is written
    run = rf.load_run(folder)
    run.write_means()
    assert rf.load_run(folder).summary == run.summarize()


@pytest.mark.parametrize(
    "content", ["[]", "{", '{"exclusion reasons": 3, "sample_set": [], "intervals": [["cre", "fog", "x", 1]]}']
)
def test_cached_values_of_another_shape_are_computed_again(folder, tmp_path, content):
    write_made(folder, CACHED_VALUES_FILE, content.encode(), rf.load_run(folder)._source)
    assert _asked(rf.load_run(folder)) == _computed(folder, tmp_path)


def test_a_folder_that_cannot_be_written_keeps_nothing(folder, monkeypatch):
    (folder / STALENESS_FILE).unlink()
    run = rf.load_run(folder)
    whole = _asked(run)

    def refuse(*_):
        raise DataError("read-only")

    monkeypatch.setattr("robustflow.runs.staleness.write_bytes", refuse)
    run.keep()
    assert _asked(rf.load_run(folder)) == whole


def test_the_digest_of_a_folder_is_of_its_shards(folder):
    whole = RunFolder(folder).digest()
    assert RunFolder(folder).digest() == whole
    (shard,) = list_shards(folder / "rows")
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    assert RunFolder(folder).digest() != whole
    with pytest.raises(RunError, match="damaged"):
        _ = rf.load_run(folder).summary


def test_a_file_of_the_package_that_goes_while_it_is_listed_is_left_out(monkeypatch):
    code_digest.cache_clear()
    before = code_digest()
    listed = Path.rglob
    monkeypatch.setattr(Path, "rglob", lambda path, pattern: [*listed(path, pattern), path / "renamed_meanwhile.py"])
    monkeypatch.setattr(Path, "is_file", lambda path: True)  # the file exists when the folder is listed
    code_digest.cache_clear()
    assert code_digest() == before

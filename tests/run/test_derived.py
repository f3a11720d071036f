"""Files and values derived from a run are reused while nothing changes, and never used for different rows."""

import json
import shutil
from unittest.mock import Mock

import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, RunError
from robustflow.core.files import sealed
from robustflow.run import run as run_module
from robustflow.run.comparable import run_facts, sample_set
from robustflow.run.store import RunFolder, list_shards
from robustflow.run.trust import DERIVED
from robustflow.stats.exclusion import exclusion_reasons
from robustflow.stats.intervals import interval_ends
from robustflow.testing import ConstantFlow

from ..refusals import refusal
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
    return shutil.copytree(made, tmp_path / "run")


@pytest.fixture
def summaries(monkeypatch):
    """Count how often means are computed."""
    counting = Mock(wraps=run_module.summarize)
    monkeypatch.setattr(run_module, "summarize", counting)
    return counting


def test_unchanged_run_is_not_summarised_again(folder, summaries):
    files = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}
    again = rf.evaluate(MODEL, output=folder, corruptions=["contrast", "high_light"], severities=[1])
    assert again.means == rf.load_run(folder).average().means
    assert summaries.call_count == 1, "the one here"
    for name in ("report.html", "summary.json"):
        assert files[folder / name] == ((folder / name).read_bytes(), (folder / name).stat().st_mtime_ns)
    assert files[folder / "manifest.json"][0] == (folder / "manifest.json").read_bytes()


def test_stored_means_have_the_order_of_computed_ones(folder, summaries):
    """JSON sorts keys; tables and figures follow the paper's order, which the summary uses."""
    names = ["contrast+pixelate", "impulse_noise", "fog", "contrast"]
    rf.evaluate(MODEL, output=folder, corruptions=names, severities=[1])
    summaries.reset_mock()
    run = rf.load_run(folder)
    computed = run.average()
    assert run.averages == computed
    assert summaries.call_count == 1, "the first one was kept"
    assert list(run.measured.corruptions) == ["contrast", "high_light", "fog", "impulse_noise", "contrast+pixelate"]


def test_a_report_is_written_again_when_what_it_shows_changed(folder, monkeypatch):
    shown = Mock(return_value="")
    monkeypatch.setattr("robustflow.report.site.page.draw_figures", lambda run: (None, []))
    monkeypatch.setattr("robustflow.report.site.page.render_site", shown)
    run = rf.load_run(folder)
    run.write_report()
    assert not shown.called
    (folder / "displacement.json").write_text("{}")
    run.write_report()
    assert shown.called


def _edit_json(name, **values):
    def edit(folder):
        path = folder / name
        path.write_text(json.dumps({**json.loads(path.read_text()), **values}))

    return edit


def _double_errors(folder):
    edit_rows(folder, lambda rows: rows.with_columns(epe_sum=2 * pl.col("epe_sum"), frames_digest=pl.lit("0")))


def _edit_manifest(folder):
    edit_manifest(folder, lambda manifest: {**manifest, "planned": [{"samples": list(manifest["samples"])}]})


def _with_values(values):
    """Write values as another version could, with matching digests."""

    def edit(folder):
        derived = rf.load_run(folder).derived
        derived._known, derived._new = values, True
        derived.write_values()

    return edit


def _list_of(content):
    return lambda folder: (folder / DERIVED).write_text(content)


EDITS = {
    "none": lambda folder: None,
    "summary": _edit_json("summary.json", epe_clean=0.001),
    "rows": _double_errors,
    "values": lambda folder: _edit_json(DERIVED, values={"sample_set": "0", "exclusion reasons": ["a lie"]})(folder),
    "manifest": _edit_manifest,
    "list of values": _with_values([]),
    "types of values": _with_values({"exclusion reasons": 3, "sample_set": [], "intervals": [["cre", "fog", "x", 1]]}),
    "empty list": _list_of(""),
    "list without digest": _list_of('{"summary.json": 3}'),
    "list of another type": _list_of(json.dumps(sealed({"summary.json": 3, "values": 3}))),
    "deep list": _list_of("[" * 100_000),
}


def _page_values(run):
    """Everything that pages request from a run."""
    reasons, ends = exclusion_reasons(run), interval_ends(run, beside_published=True)
    return sample_set(run), run_facts([run]), reasons, ends, run.means, run.measured


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_stored_summary_equals_a_computed_one(folder, tmp_path, edit):
    assert "values" in json.loads((folder / DERIVED).read_text()), "the run's report stored the values"
    edit(folder)
    bare = shutil.copytree(folder, tmp_path / "copy")
    for name in (DERIVED, "summary.json"):
        (bare / name).unlink(missing_ok=True)
    computed = rf.load_run(bare)
    run = rf.load_run(folder)
    assert _page_values(run) == _page_values(computed)
    run.write_means()
    computed.write_means()
    assert (folder / "summary.json").read_bytes() == (bare / "summary.json").read_bytes()


def test_stored_summary_is_read_without_the_rows(folder, monkeypatch):
    for name in (DERIVED, "summary.json"):
        (folder / name).unlink()
    run = rf.load_run(folder)
    whole = _page_values(run)
    run.keep()
    monkeypatch.setattr(RunFolder, "rows", lambda *_: pytest.fail("rows were read"))
    monkeypatch.setattr(RunFolder, "scan", lambda *_: pytest.fail("rows were read"))
    assert _page_values(rf.load_run(folder)) == whole


def test_rows_added_while_a_run_is_read_invalidate_the_stored_summary(folder):
    run = rf.load_run(folder)
    assert run.rows.height
    _double_errors(folder)
    before = exclusion_reasons(run)
    run.keep()
    later = rf.load_run(folder)
    assert "exclusion reasons" not in later.derived
    assert exclusion_reasons(later) != before


def test_read_only_run_folder_stores_no_summary(folder, monkeypatch):
    (folder / DERIVED).unlink()
    run = rf.load_run(folder)
    whole = _page_values(run)

    monkeypatch.setattr("robustflow.run.trust.write_bytes", Mock(side_effect=DataError("read-only")))
    run.keep()
    assert _page_values(rf.load_run(folder)) == whole


def test_a_damaged_shard_is_refused_although_the_means_are_stored(folder):
    (shard,) = list_shards(folder / "rows")
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    refusal(lambda: rf.load_run(folder).means, RunError, shard)

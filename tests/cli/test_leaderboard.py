"""Test the commands `leaderboard` and `report --format page`."""

import json
import shutil
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from robustflow.stats.imported import NOTE
from robustflow.stats.lines import lines_of
from robustflow.stats.published.tables import published_frame
from robustflow.stats.results import RESULT_METRICS
from robustflow.stats.results_file import read_results

_RESULTS = "setting,model,metric,corruption,value\nOOD,Mine,epe,clean,2.50\nOOD,Mine,epe,average,5.00\n"


@pytest.fixture
def run(runs):
    return runs[0]


def test_leaderboard_without_runs_shows_the_published_results(robustflow, monkeypatch):
    monkeypatch.setattr("robustflow.report.site.render_site", lambda *_: "a page")
    assert robustflow.prints("leaderboard", "-o", "site") == "site/index.html\n"
    assert sorted(path.name for path in Path("site").iterdir()) == ["index.html", "results.csv"]
    shown = published_frame().filter(pl.col("measure").is_in(RESULT_METRICS)).drop("source")
    assert_frame_equal(read_results("site/results.csv").drop("source"), shown)


def test_leaderboard_shows_runs_and_files_beside_published_results(robustflow, run):
    Path("mine.csv").write_text(_RESULTS)
    robustflow.prints("leaderboard", run, "mine.csv", "-o", "site")
    page = Path("site/index.html").read_text()
    assert "Claimed: mine.csv" in page
    assert "Tab. 2" in page
    robustflow.prints("leaderboard", run, "--no-published", "-o", "alone")
    assert "Tab. 2" not in Path("alone/index.html").read_text()


def test_a_page_of_many_runs_leaves_the_example_pictures_out(robustflow, run, monkeypatch):
    asked = []
    monkeypatch.setattr("robustflow.report.site.examples.embedded_slider", lambda: asked.append(1))
    monkeypatch.setattr("robustflow.report.site.content.MOST_DETAILED", 2)
    without = shutil.ignore_patterns("examples")
    many = [shutil.copytree(run, f"many/{number}", ignore=without) for number in range(3)]
    for runs in (many[1:], many):
        robustflow.prints("leaderboard", *runs, "--no-published", "-o", "site")
        assert len(asked) == 1


def test_imported_results_are_shown_beside_a_run_and_marked_unverified(robustflow, run):
    Path("RAFT_ood").mkdir()
    values = {"CRE": [1, 2, 3, 4, 5], "rCRE": [2, 3, 4, 5, 6], "clean_EPE": [3] * 5, "corrupt_EPE": [4, 5, 6, 7, 8]}
    Path("RAFT_ood/results.json").write_text(json.dumps({"brightness": values}))
    robustflow.prints("leaderboard", run, "RAFT_ood/results.json", "--no-published", "-o", "site")
    page = Path("site/index.html").read_text()
    imported = ("RAFT_ood", "Reference code, kitti-fc")
    for text in (*imported, NOTE, "Claimed: "):
        assert text in page
    lines = lines_of(read_results("site/results.csv"))
    (raft,) = (line for key, line in lines.items() if key.model == "RAFT_ood")
    assert raft.number("epe", "high_light") == 6.0
    robustflow.refuses("leaderboard", run / "summary.json", "--no-published", code=1)


def test_report_as_a_page_has_all_tables(robustflow, run):
    page = ("report", run, "--format", "page")
    assert robustflow.prints(*page, "-o", "report.html") == "report.html\n"
    assert "<!doctype html>" in Path("report.html").read_text()

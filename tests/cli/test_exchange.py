"""Test the export of rows for other programs, and a folder of records to which several people contribute."""

import hashlib
import io
import json
from pathlib import Path

import polars as pl
import pytest

from robustflow.api import load_run
from robustflow.core.errors import RunError
from robustflow.core.files import digest_of_value, json_bytes, sealed
from robustflow.corruptions.api import STREAM_VERSION
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.report.site.content import whole_content
from robustflow.report.site.data import page_data
from robustflow.run.records.format import container_bytes
from robustflow.run.records.pack import add_records, collected, load_any_run, pack, record_bytes
from robustflow.stats.results_file import read_results, results_csv

from ..refusals import refusal
from ..run.records.forge import entries_of


@pytest.fixture(scope="module")
def run(runs):
    return runs[1]


@pytest.fixture(scope="module")
def packed(run):
    """Two records of one run, made by two people: author -> contents."""
    return {author: record_bytes(load_run(run), author=author) for author in ("Ada", "Bob")}


@pytest.fixture
def records(packed, tmp_path):
    """The two records as files."""
    for author, contents in packed.items():
        (tmp_path / f"{author}.robustflow").write_bytes(contents)
    return [tmp_path / f"{author}.robustflow" for author in packed]


@pytest.mark.parametrize("format", ["csv", "parquet"])
def test_exported_rows_are_unchanged_after_reading(robustflow, run, format):
    assert robustflow.prints("export", run, "--format", format).strip() == f"rows.{format}"
    data = Path(f"rows.{format}").read_bytes()
    if format == "parquet":
        digest = load_run(run).manifest.identity_digest
        assert pl.read_parquet_metadata("rows.parquet")["robustflow_run"] == digest
    reader = pl.read_parquet if format == "parquet" else pl.read_csv
    options = {} if format == "parquet" else {"schema": ROW_SCHEMA}
    rows = load_run(run).rows
    assert rows.columns == list(ROW_SCHEMA)
    assert reader(io.BytesIO(data), **options).equals(rows.sort("sample", "corruption", "severity"))


def test_an_exported_file_is_verified_with_the_record_and_refused_after_a_change(robustflow, run, records):
    results, rows = Path("huggingface/.eval_results/robustflow.yaml"), Path("rows.csv")
    assert robustflow.prints("export", run, "-f", "huggingface", "--hub-dataset", "a/b").strip() == str(results)
    assert robustflow.prints("export", run, "-f", "csv").strip() == str(rows)
    out = robustflow.prints("record", "verify", records[0], "--exported", results, "--exported", rows)
    assert "exported      files exported from the run match the record: 2 files" in out
    results.write_text(results.read_text().replace("task_id: epe", "task_id: cre", 1))
    code, out, _ = robustflow("record", "verify", records[0], "--exported", results)
    assert code == 1
    assert str(results) in out


def test_records_are_added_one_after_the_other(run, records, tmp_path):
    (copy,) = add_records(tmp_path / "packed", [run]).copies
    assert copy.read_bytes() == pack(load_run(run), tmp_path / "same.robustflow").read_bytes()
    site = tmp_path / "site"
    for record in records:
        add_records(site, [record])
    assert {path.read_bytes() for path in collected(site)} == {path.read_bytes() for path in records}
    assert add_records(site, records[::-1]).earlier == []
    assert len(collected(site)) == 2


def test_an_earlier_record_of_a_model_is_named_and_removed_on_request(robustflow, runs, records, monkeypatch):
    """Two records belong to the same model; the record of a different model is kept."""
    monkeypatch.setattr("robustflow.report.site.render_site", lambda *_: "a page")
    add = ("leaderboard", "site", "--add")
    assert robustflow(*add, records[0], "--add", runs[0]) == (0, "site/index.html\n", "")
    first, kept = sorted(collected(Path("site")), key=lambda path: path.read_bytes() != records[0].read_bytes())
    code, _, error = robustflow(*add, records[1])
    assert code == 0
    assert error.startswith(f"records/{first.name} (Farneback (knowledge) on ")
    assert "--supersede removes it" in error
    assert error.count("\n") == 1
    assert len(collected(Path("site"))) == 3
    assert robustflow(*add, runs[1], "--supersede")[2].count(": removed\n") == 2
    left = {path.read_bytes() for path in collected(Path("site"))}
    assert left == {kept.read_bytes(), pack(load_run(runs[1]), "again.robustflow").read_bytes()}
    assert len(list(Path("site/records").iterdir())) == 2
    robustflow.refuses("leaderboard", "site", "--supersede")


def test_no_record_is_added_if_one_does_not_verify(records, tmp_path):
    site = tmp_path / "site"
    altered = bytearray(records[1].read_bytes())
    altered[len(altered) // 2] ^= 1
    records[1].write_bytes(altered)
    refusal(lambda: add_records(site, records), RunError, records[1])
    assert not site.exists()


def test_a_damaged_record_of_a_collection_is_left_out_and_named(robustflow, runs, records, monkeypatch):
    monkeypatch.setattr("robustflow.report.site.render_site", lambda *_: "a page")
    (copy,) = add_records(Path("site"), records[:1]).copies
    copy.write_bytes(records[0].read_bytes()[:-1])
    code, _, error = robustflow("leaderboard", "site", "--add", records[1])
    assert code == 0
    assert error.startswith(f"left out: {copy}: ")
    assert error.count("\n") == 1
    assert "Farneback" in set(read_results("site/results.csv")["model"])


def test_leaderboard_leaves_out_only_the_record_of_an_earlier_version(robustflow, run, records, monkeypatch):
    """The board shows the others, `report` gives the same reason, and the record cannot be added to a collection."""
    monkeypatch.setattr("robustflow.report.site.render_site", lambda *_: "a page")
    old = Path("old.robustflow")
    entries = entries_of(records[0].read_bytes())
    manifest = json.loads(entries["manifest.json"])
    manifest["identity"]["frames"]["streams"] = STREAM_VERSION - 1
    manifest["identity_digest"] = digest_of_value(manifest["identity"])
    old.write_bytes(container_bytes(entries | {"manifest.json": json_bytes(sealed(manifest))}))
    reason = robustflow.refuses("report", old, code=1)
    code, out, left_out = robustflow("leaderboard", records[0], old, "--no-published", "-o", "page")
    assert (code, out) == (0, "page/index.html\n")
    assert left_out == f"left out: {reason.removeprefix('robustflow: ')}\n"
    assert set(read_results("page/results.csv")["model"]) == {"Farneback"}
    assert robustflow.refuses("leaderboard", old, code=1) == reason
    assert "absent" in robustflow.refuses("leaderboard", records[0], "absent", code=1)
    add_records(Path("site"), records)
    with pytest.raises(RunError):
        add_records(Path("site"), [old])


def test_line_of_a_record_states_its_source_on_the_page_and_in_results(records):
    content = whole_content([load_any_run(records[0])], published=False)
    assert set(content.frame["source"]) == {"verified record"}
    shown = page_data(content, {})
    assert shown["boards"][0]["sections"][0]["lines"][0]["remark"] == "verified record"
    (page,) = shown["models"].values()
    (source, *_) = page["tables"][-1]["sections"][0]["lines"]
    assert source["texts"] == f"verified record {hashlib.sha256(records[0].read_bytes()).hexdigest()}"
    assert results_csv(content.frame).splitlines()[1].endswith(",verified record")

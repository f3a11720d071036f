"""Test the export of rows for other programs, and a folder of records to which several people contribute."""

import io
import re
from pathlib import Path

import polars as pl
import pytest

from robustflow.api import evaluate, load_run
from robustflow.errors import DataError, RunError
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.records.collection import LIST, add_records, collected
from robustflow.records.pack import pack, record_bytes


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "still"
    return evaluate("farneback", "demo", output=folder, corruptions=["contrast"], severities=[1]).path


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
def test_rows_come_back_as_they_were(robustflow, run, format):
    code, out, _ = robustflow("export", run, "--format", format)
    assert (code, out.strip()) == (0, f"rows.{format}")
    data = Path(f"rows.{format}").read_bytes()
    reader = pl.read_parquet if format == "parquet" else pl.read_csv
    options = {} if format == "parquet" else {"schema": ROW_SCHEMA}
    rows = load_run(run).rows
    assert rows.columns == list(ROW_SCHEMA)
    assert reader(io.BytesIO(data), **options).equals(rows.sort("sample", "corruption", "severity"))


def test_a_parquet_file_says_which_run_it_is(robustflow, run):
    robustflow("export", run, "--format", "parquet", "-o", "mine.parquet")
    digest = load_run(run).manifest.identity_digest
    assert pl.read_parquet_metadata("mine.parquet")["robustflow_run"] == digest


def test_an_unknown_format_of_a_run_is_one_line_with_the_known_ones(robustflow, run):
    code, _, error = robustflow("export", run, "--format", "xlsx")
    assert code == 2
    assert error.count("\n") == 1
    assert "csv, parquet, card, croissant, every-eval-ever, huggingface, robustspring" in error


def test_a_card_is_verified_with_the_record_and_refused_after_a_change(robustflow, run, records):
    code, out, _ = robustflow("export", run, "--format", "card")
    assert (code, out.split()) == (0, ["card/card.md", "card/card.json"])
    code, out, _ = robustflow("verify", records[0], "--exported", "card/card.md", "--exported", "card/card.json")
    assert code == 0
    assert "exported      files exported from the run match the record: 2 files" in out
    card = Path("card/card.md")
    card.write_text(card.read_text().replace("| average | ", "| average | 1", 1))
    code, out, _ = robustflow("verify", records[0], "--exported", card)
    assert code == 1
    assert "card/card.md, line " in out


def test_records_are_added_one_after_the_other(records, tmp_path):
    site = tmp_path / "site"
    for record in records:
        add_records(site, [record])
    list_of_both = (site / LIST).read_bytes()
    assert {path.read_bytes() for path in collected(site)} == {path.read_bytes() for path in records}
    add_records(site, records[::-1])
    assert (site / LIST).read_bytes() == list_of_both


def test_a_folder_of_a_run_is_packed_and_added(run, tmp_path):
    (copy,) = add_records(tmp_path / "site", [run]).copies
    assert copy.read_bytes() == pack(load_run(run), tmp_path / "same.robustflow").read_bytes()
    assert collected(tmp_path / "site") == [copy]


def test_an_earlier_record_of_a_model_is_named_and_removed_on_request(robustflow, run, records, monkeypatch):
    """Two records belong to the same model; the record of a different model is kept."""
    monkeypatch.setattr("robustflow.report.site.render_site", lambda *_: "a page")
    other = evaluate("dis", "demo", output="other", corruptions=["contrast"], severities=[1]).path
    assert robustflow("leaderboard", "site", "--add", records[0], "--add", other)[2] == ""
    first, kept = sorted(collected(Path("site")), key=lambda path: path.read_bytes() != records[0].read_bytes())
    code, _, error = robustflow("leaderboard", "site", "--add", records[1])
    assert code == 0
    assert error.startswith(f"records/{first.name} (Farneback on demo")
    assert "--supersede removes it" in error
    assert error.count("\n") == 1
    assert len(collected(Path("site"))) == 3
    code, _, error = robustflow("leaderboard", "site", "--add", run, "--supersede")
    assert code == 0
    assert error.count(": removed\n") == 2
    left = {path.read_bytes() for path in collected(Path("site"))}
    assert left == {kept.read_bytes(), pack(load_run(run), "again.robustflow").read_bytes()}
    assert len(list(Path("site/records").iterdir())) == 2
    assert robustflow("leaderboard", "site", "--supersede")[0] == 2


def test_what_does_not_verify_is_not_added_nor_what_comes_with_it(records, tmp_path):
    site = tmp_path / "site"
    altered = bytearray(records[1].read_bytes())
    altered[len(altered) // 2] ^= 1
    records[1].write_bytes(altered)
    with pytest.raises(RunError, match="does not verify"):
        add_records(site, records)
    assert not site.exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("records/", "../records/"), "not named after its hash"),
        (lambda text: re.sub(r'"version": \d', '"version": 9', text), "version 9"),
        (lambda text: "{", "not a list of records"),
    ],
)
def test_a_list_that_was_tampered_with(records, tmp_path, change, says):
    add_records(tmp_path / "site", records)
    path = tmp_path / "site" / LIST
    before = path.read_text()
    path.write_text(change(before))
    assert path.read_text() != before
    with pytest.raises(DataError, match=says):
        collected(tmp_path / "site")


def test_a_record_that_was_exchanged_or_is_gone(records, tmp_path):
    (copy,) = add_records(tmp_path / "site", records[:1]).copies
    copy.write_bytes(records[1].read_bytes())
    with pytest.raises(DataError, match="not the file listed"):
        collected(tmp_path / "site")
    copy.unlink()
    with pytest.raises(DataError, match="but missing"):
        collected(tmp_path / "site")


def test_a_page_is_written_into_one_folder(robustflow, records):
    for arguments in (["--add", records[0]], ["a", "b", "--add", records[0]], ["a", "--add", records[0], "-o", "b"]):
        code, _, error = robustflow("leaderboard", *arguments)
        assert code == 2
        assert "one folder of records" in error


@pytest.mark.slow
def test_the_page_of_a_folder_of_records(robustflow, records):
    code, out, error = robustflow("leaderboard", "site", "--add", records[0], "--no-published")
    assert (code, out.strip()) == (0, "site/index.html"), error
    results = Path("site/results.csv").read_text()
    assert "Farneback" in results
    assert robustflow("leaderboard", "site", "-o", "elsewhere", "--no-published")[0] == 0
    assert Path("elsewhere/results.csv").read_text() == results

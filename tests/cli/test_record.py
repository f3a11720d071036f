"""Test the commands `record pack` and `record verify`, and records used as runs."""

import json
from pathlib import Path

import pytest

from robustflow.api import load_run
from robustflow.run.records.pack import record_bytes


@pytest.fixture(scope="module")
def packed(runs):
    """Both runs as records: file name -> contents."""
    texts = {"author": "Ada", "link": "https://example.org"}
    return {f"{run.name}.robustflow": record_bytes(load_run(run), **texts) for run in runs}


@pytest.fixture
def records(robustflow, packed):
    """The record files in the working folder, without the run folders."""
    for name, contents in packed.items():
        Path(name).write_bytes(contents)
    return [*map(Path, packed)]


def test_packed_record_verifies(robustflow, runs, packed):
    options = ("--author", "Ada", "--link", "https://example.org")
    records = [Path(robustflow.prints("record", "pack", run, *options).strip()) for run in runs]
    assert {path.name: path.read_bytes() for path in records} == packed
    out = robustflow.prints("record", "verify", *records)
    assert out.count("\n  verified, SHA-256 ") == 2
    assert "author: Ada" in out
    checked = robustflow.prints("record", "verify", records[0], "--check-frames", 3, "--seed", 1)
    assert "3 of 3 " in checked


def test_verify_repeats_predictions_on_request(robustflow, records):
    """A record of DIS verifies with DIS but not with Farneback, on the same frames."""
    out = robustflow.prints("record", "verify", records[0], "--model", "dis")
    assert "3 of 3 " in out
    assert "DIS (knowledge) on " in out
    code, out, _ = robustflow("record", "verify", records[1], "--model", "dis")
    assert code == 1
    assert "failed       predictions" in out


def test_record_of_a_different_run_is_not_overwritten(robustflow, runs, records):
    before = records[0].read_bytes()
    robustflow.refuses("record", "pack", runs[1], "-o", records[0], code=1)
    assert records[0].read_bytes() == before


def test_a_changed_record_fails_and_the_others_are_still_checked(robustflow, records):
    data = bytearray(records[0].read_bytes())
    data[len(data) // 3] ^= 1
    Path("bad\x1b[31m.robustflow").write_bytes(data)
    code, out, err = robustflow("record", "verify", "bad\x1b[31m.robustflow", records[1], "nowhere")
    assert code == 1
    assert not err
    assert "\x1b" not in out
    assert out.count("not verified: ") == 2
    assert out.count("\n  verified") == 1
    code, out, _ = robustflow("record", "verify", "nowhere", "--json")
    assert code == 1
    found = json.loads(out)[0]
    assert not found["ok"]
    assert found["checks"][0]["status"] == "failed"


def test_showing_a_record_writes_nothing(robustflow, records, runs):
    there = sorted(Path().iterdir())
    of_run = robustflow.prints("report", runs[0])
    assert robustflow("report", records[0]) == (0, of_run[: of_run.index("report:")], "")
    assert sorted(Path().iterdir()) == there


def test_verify_frames_without_the_data_is_refused(robustflow, records):
    code, out, _ = robustflow("record", "verify", records[0], "--data", "nowhere")
    assert code == 1
    assert "failed       frames" in out


def test_records_are_accepted_where_runs_are_read(robustflow, runs, records):
    def same(*arguments):
        command, *options = arguments
        assert robustflow.prints(command, *runs, *options) == robustflow.prints(command, *records, *options)

    same("report", "--published", "-t", "epe,cost,means", "-f", "csv")
    same("compare", "--metric", "cre")

"""Results files are read, and invalid ones are rejected."""

import polars as pl
import pytest

from robustflow.core.errors import DataError
from robustflow.stats.lines import lines_of, number_of
from robustflow.stats.results_file import parse_results, read_results, results_csv
from tests.refusals import refusal

_HEAD = "setting,model,metric,corruption,value\n"


def test_a_file_is_read_with_its_decimals(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("\ufeffmodel,setting,metric,corruption,value,marked,extra\n" + "A,OOD,epe,fog,1.250,yes,z\n")
    row = read_results(path).row(0, named=True)
    known = ("benchmark", "measure", "condition", "severity", "value", "decimals", "marked")
    assert [row[name] for name in known] == ["kitti-fc", "epe", "fog", None, 1.25, 3, True]


@pytest.mark.parametrize(("written", "shown"), [("4.20", "4.20"), ("1.527602461899183", "1.53"), ("7", "7")])
def test_a_number_is_shown_as_it_was_printed_unless_it_was_never_rounded(tmp_path, written, shown):
    path = tmp_path / "mine.csv"
    path.write_text(f"{_HEAD}OOD,Mine,rcre,fog,{written}\n")
    frame = read_results(path)
    row = frame.row(0, named=True)
    assert row["value"] == float(written)
    assert number_of(row) == shown
    path.write_text(results_csv(frame))
    assert read_results(path).equals(frame)


def test_results_file_keeps_the_coverage_of_errors():
    head = _HEAD.replace("value", "value,coverage")
    frame = parse_results(f"{head}OOD,A,rcre,fog,1.00,0.625\nOOD,B,rcre,fog,1.00,\n", "mine.csv", "mine")
    again = parse_results(results_csv(frame), "mine.csv", "mine")
    assert [line.coverage for of in (frame, again) for line in lines_of(of).values()] == [0.625, None, 0.625, None]
    mixed = parse_results(f"{head}OOD,A,rcre,fog,1.00,\nOOD,A,rcre,snow,1.00,0.5\n", "mine.csv", "mine")
    assert [line.coverage for line in lines_of(mixed).values()] == [0.5]


@pytest.mark.parametrize("number", [0.0, 0.5, 12.0, 1e-5, 0.1 + 0.2, 1e8 + 0.125])
def test_unrounded_number_with_few_digits_stays_unrounded_after_a_round_trip(number):
    frame = parse_results(f"{_HEAD}OOD,Mine,rcre,fog,1.00\n", "mine.csv", "mine")
    exact = frame.with_columns(value=pl.lit(number), decimals=pl.lit(None, pl.Int64))
    assert parse_results(results_csv(exact), "mine.csv", "mine").equals(exact)


OF_FILE, OF_LINE = "r.csv", "r.csv, line 2"
PARTLY = _HEAD.replace("value", "value,coverage")
WRONG = [
    ("model,value\nA,1\n", OF_FILE),
    ("", OF_FILE),
    (_HEAD.strip() + ",value\nOOD,A,epe,fog,1,2\n", OF_FILE),
    *(
        (f"{_HEAD}OOD,A,{metric},{name},{value}\n", OF_LINE)
        for metric, name, value in (
            *(("epe", "fog", value) for value in ("nan", "inf", "1e99", "one", "-1", "1,2,3")),
            ("speed", "fog", "1"),
            ("epe", "fogg", "1"),
            ("epe", "fog+snoww", "1"),
        )
    ),
    (_HEAD + "OOD,A,cre,fog,-1\nOOD,A,epe,fog,-1\n", "r.csv, line 3"),
    (_HEAD + "OOD,A,epe,fog,1\nOOD,A,epe,fog,2\n", OF_FILE),
    (_HEAD + "OOD,A,epe,fog\n", OF_LINE),
    (_HEAD + ",A,epe,fog,1\n", OF_LINE),
    (_HEAD + f"OOD,{'A' * 1000},epe,fog,1\n", OF_LINE),
    (_HEAD + 'OOD,"A,epe,fog,1\n', "r.csv, line 1"),
    ("setting,model,metric,corruption,value,marked\nOOD,A,epe,fog,1,maybe\n", OF_LINE),
    *((f"{PARTLY}OOD,A,rcre,fog,1.00,{share}\n", OF_LINE) for share in ("1.5", "-0.1", "much", "nan")),
]


@pytest.mark.parametrize(("text", "culprit"), WRONG)
def test_wrong_results_file_is_refused(text, culprit):
    refusal(lambda: parse_results(text, "r.csv", "x"), DataError, culprit)


def test_unreadable_results_file_is_refused(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.csv", tmp_path / "binary.csv", tmp_path):
        refusal(lambda path=path: read_results(path), DataError, path)

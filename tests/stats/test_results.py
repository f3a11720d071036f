"""Results files are read, and invalid ones are rejected."""

from dataclasses import replace

import pytest

from robustflow.core.errors import DataError
from robustflow.report.table import number_text
from robustflow.stats.model_result import Value
from robustflow.stats.results_file import parse_results, read_results, results_csv
from tests.refusals import refused

_HEAD = "setting,model,metric,corruption,value\n"


def test_a_file_is_read_with_its_decimals(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("\ufeffmodel,setting,metric,corruption,value,marked,extra\n" + "A,OOD,epe,fog,1.250,yes,z\n")
    (line,) = read_results(path)
    assert line.benchmark == "kitti-fc"
    assert line.values == {("epe", "fog"): Value(1.25, decimals=3, marked=True)}


@pytest.mark.parametrize(("written", "shown"), [("4.20", "4.20"), ("1.527602461899183", "1.53"), ("7", "7")])
def test_a_number_is_shown_as_it_was_printed_unless_it_was_never_rounded(tmp_path, written, shown):
    path = tmp_path / "mine.csv"
    path.write_text(f"{_HEAD}OOD,Mine,rcre,fog,{written}\n")
    (line,) = read_results(path)
    value = line.values["rcre", "fog"]
    assert value.number == float(written)
    assert number_text(value.number, value.decimals) == shown
    path.write_text(results_csv([line]))
    assert list(map(vars, read_results(path))) == [vars(line)]


def test_results_file_keeps_the_coverage_of_errors():
    head = _HEAD.replace("value", "value,coverage")
    partly, whole = parse_results(f"{head}OOD,A,rcre,fog,1.00,0.625\nOOD,B,rcre,fog,1.00,\n", "mine.csv", "mine")
    again = parse_results(results_csv([partly, whole]), "mine.csv", "mine")
    assert [line.coverage for line in (partly, whole, *again)] == [0.625, None, 0.625, None]
    (mixed,) = parse_results(f"{head}OOD,A,rcre,fog,1.00,\nOOD,A,rcre,snow,1.00,0.5\n", "mine.csv", "mine")
    assert mixed.coverage == 0.5
    for wrong in ("1.5", "-0.1", "much", "nan"):
        with refused(DataError, "'coverage' must be a number from 0 to 1"):
            parse_results(f"{head}OOD,A,rcre,fog,1.00,{wrong}\n", "mine.csv", "mine")


@pytest.mark.parametrize("number", [0.0, 0.5, 12.0, 1e-5, 0.1 + 0.2, 1e8 + 0.125])
def test_unrounded_number_with_few_digits_stays_unrounded_after_a_round_trip(number):
    (line,) = parse_results(f"{_HEAD}OOD,Mine,rcre,fog,1.00\n", "mine.csv", "mine")
    (again,) = parse_results(results_csv([replace(line, values={("rcre", "fog"): Value(number)})]), "mine.csv", "mine")
    assert again.values["rcre", "fog"] == Value(number)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("model,value\nA,1\n", "no column 'setting'"),
        ("", "no column"),
        (_HEAD.strip() + ",value\nOOD,A,epe,fog,1,2\n", "the column 'value' appears twice"),
        (_HEAD + "OOD,A,epe,fog,nan\n", "not a finite number"),
        (_HEAD + "OOD,A,epe,fog,inf\n", "not a finite number"),
        (_HEAD + "OOD,A,epe,fog,1e99\n", "not a finite number"),
        (_HEAD + "OOD,A,cre,fog,-1\nOOD,A,epe,fog,-1\n", "line 3: EPE -1: a length"),
        (_HEAD + "OOD,A,epe,fog,one\n", "line 2: 'one' is not a number"),
        (_HEAD + "OOD,A,speed,fog,1\n", "unknown metric 'speed'"),
        (_HEAD + "OOD,A,epe,fogg,1\n", "line 2: unknown corruption 'fogg': did you mean 'fog'"),
        (_HEAD + "OOD,A,epe,fog+snoww,1\n", "line 2: unknown corruption 'snoww'"),
        (_HEAD + "OOD,A,epe,fog,1\nOOD,A,epe,fog,2\n", "appears twice"),
        (_HEAD + "OOD,A,epe,fog\n", "the number of cells differs"),
        (_HEAD + "OOD,A,epe,fog,1,2,3\n", "the number of cells differs"),
        (_HEAD + ",A,epe,fog,1\n", "'setting' must be"),
        (_HEAD + f"OOD,{'A' * 1000},epe,fog,1\n", "'model' must be"),
        (_HEAD + 'OOD,"A,epe,fog,1\n', "unexpected end of data"),
        ("setting,model,metric,corruption,value,marked\nOOD,A,epe,fog,1,maybe\n", "'marked' must be"),
    ],
)
def test_wrong_results_file_is_refused_in_one_sentence(text, says):
    with refused(DataError, says):
        parse_results(text, "r.csv", "x")


def test_unreadable_results_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="No such file"):
        read_results(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="not UTF-8"):
        read_results(tmp_path / "binary.csv")
    with pytest.raises(DataError, match="directory"):
        read_results(tmp_path)

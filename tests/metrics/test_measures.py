"""The tables of columns and measures: what follows from a declaration, and the arithmetic of rows."""

from __future__ import annotations

import ast
import inspect
import json
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

import robustflow
from robustflow.core import compiled
from robustflow.metrics import error_maps, measures, photometric, regions, rows
from robustflow.metrics.rows import COLUMNS

EVERY = {
    **measures.EVERY,
    **{f"{name} {region}": one for region, of in measures.REGION_MEASURES.items() for name, one in of.items()},
}


@pytest.mark.parametrize("name", EVERY)
def test_measure_is_computed_from_columns_of_the_rows(name):
    parts = EVERY[name].parts
    used = {column for part in parts for value in (part.total, part.count) for column in value.meta.root_names()}
    assert used <= {*COLUMNS}
    assert {part.paired for part in parts} <= {"", *COLUMNS}
    assert EVERY[name].label


PLANTED = """
import json, sys
import polars as pl
from robustflow.metrics import MEASURES
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.run.records.row_rules import RULES
from robustflow.run.summary import summarize

def row(corruption, severity, **changed):
    values = {name: None if kind is pl.String else 0 for name, kind in ROW_SCHEMA.items()}
    values |= {"sample": "a", "group": "a", "truth": "unchanged", "corruption": corruption, "severity": severity}
    values |= {"height": 2, "width": 5, "n_all": 10, "n_valid": 10, "n_truth": 10, "planted_sum": 3.0}
    return values | changed

def frame(*rows):
    return pl.DataFrame(rows, schema=ROW_SCHEMA, orient="row")

means, measured = averages = summarize(frame(row("clean", 0), row("fog", 2, planted_sum=5.0)))
document = averages.document("image")
fog = document["corruptions"]["fog"]
shown = [document["clean"]["planted"], document["planted"], fog["by_severity"]["planted"]]
shown.append(means["planted", "weather", None])
try:
    summarize(frame(row("clean", 0, planted_sum=None)))
except Exception as error:
    shown.append(type(error).__name__)
broken = [
    {reason for reason, rule in RULES.items() if frame(row("clean", 0, planted_sum=total)).filter(rule).height}
    for total in (11.0, 3.0)
]
shown.append(len(broken[0] - broken[1]))

import numpy as np
from robustflow.report.comparison import Comparison, pairs_table
from robustflow.report.notebook import plot
from robustflow.report.render import render
from robustflow.report.run_tables import severities_table
from robustflow.report.site import render_site, whole_content
from robustflow.run.run import Run
from robustflow.stats.estimate import contrast, cubes_of
from robustflow.stats.frame import CONTRAST, results_frame
from robustflow.stats.lines import lines_of
from robustflow.stats.variance import variance_split
from tests.made_rows import made_run
from tests.stats.simulated import rows_of

errors = np.random.default_rng(0).gamma(4, 1, (20, 4))
rows = rows_of(errors[:, 0], errors[:, 1:], errors[:, 1:])
share = pl.Series(np.random.default_rng(1).beta(8, 1, rows.height) * 1000)
rows, better = (rows.with_columns(planted_sum=share * factor) for factor in (1.0, 0.9))
runs = [made_run(Run(sys.argv[1]), of_run, name) for name, of_run in (("one", rows), ("other", better))]
numbers = results_frame(runs, ["means", CONTRAST]).filter(measure="planted", condition="average")
numbers = numbers.filter(pl.col("severity").is_null()).sort("against", nulls_last=False)
shown.append(numbers["low"].null_count() == 0 and numbers["high"].max() <= 100)
shown.append([numbers["wins"].to_list(), numbers["p_adjusted"].to_list()[2] < 0.01])
cubes = cubes_of({"one": rows, "other": better, "third": rows})
tables = [
    Comparison(dict(list(cubes.items())[:2])).table("planted"),
    pairs_table(contrast(cubes, {"planted": MEASURES["planted"]}, [("average", None)])),
    severities_table(next(iter(lines_of(results_frame(runs[:1])).values())), "planted", "planted (%)"),
]
texts = [render(table, format) for table in tables for format in ("terminal", "csv", "latex", "markdown", "html")]
shown.append(["planted" in text for text in texts].count(False))
shown.append(runs[0].table("planted")["mean"].null_count())
shown.append("planted (%)" in plot(runs, "severity", "planted").caption)
seeds = [of_run.filter(pl.col("corruption") != "snow") for of_run in (rows, better)]
shown.append(variance_split(dict(enumerate(seeds)), "planted").height)
page = render_site(whole_content(runs, published=False, asked="planted"))
boards = json.loads(page.partition('id="data">')[2].partition("</script>")[0])["boards"]
place = [column["label"] for column in boards[0]["columns"]].index("planted")
lines = {line["name"]: line for section in boards[0]["sections"] for line in section["lines"]}
values = {run.name: f"{run.mean('planted'):.2f}" for run in runs}
shown.append({name: line["texts"].split("\\t")[place] for name, line in lines.items()} == values)
shown.append(all(str(place) in line["intervals"] for line in lines.values()))
print(json.dumps(shown))
"""


def test_new_measure_touches_two_files(tmp_path, base):
    """A column in `rows` and a line in `measures` give means, the file, the checks of rows, the documentation, an
    interval, paired tests, tables in all formats, a figure and a column of the page."""
    package = tmp_path / "robustflow"
    shutil.copytree(Path(robustflow.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    for name, mark, line in (
        ("rows.py", '    "wauc_sum": RowColumn(', '    "planted_sum": RowColumn(_NUMBER, "Planted.", "n_valid"),\n'),
        (
            "measures.py",
            '    "px1": _percent(',
            '    "planted": _percent("planted", pl.col("planted_sum"), _valid),\n',
        ),
    ):
        path = package / "metrics" / name
        text = path.read_text()
        assert text.count(mark) == 1
        path.write_text(text.replace(mark, line + mark))
    done = subprocess.run(
        [sys.executable, "-c", PLANTED, str(base.path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": f"{tmp_path}:{Path(__file__).parents[2]}", "HOME": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    *means, refused, broken, bounded, tested, absent, empty, drawn, sources, column, interval = json.loads(done.stdout)
    assert (column, interval) == (True, True)
    assert (bounded, tested) == (True, [[None, None, 0], True])
    assert (absent, empty, drawn, sources) == (1, 0, True, 4), "only the CSV of one measure does not name it"
    assert means == [30.0, 50.0, [50.0], 50.0]
    assert refused == "RunError"
    assert broken == 1


EXACT = {"sqrt", "isfinite", "isnan", "ceil", "abs", "maximum", "range"}
TYPES = {"float64", "int64", "int32", "uint32", "uint8"}
OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.LShift, ast.RShift, ast.BitAnd, ast.BitOr)


@pytest.mark.parametrize("module", [rows, error_maps, regions, photometric], ids=lambda module: module.__name__)
def test_compiled_row_code_uses_exactly_rounded_arithmetic_only(module):
    functions = [node for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.FunctionDef)]
    in_numba = [
        one
        for one in functions
        if any("njit" in ast.unparse(d) or "inner" in ast.unparse(d) for d in one.decorator_list)
    ]
    assert in_numba
    own = {one.name for one in in_numba} | {"is_fl_outlier", "wauc_points"}
    for function in in_numba:
        for node in (node for statement in function.body for node in ast.walk(statement)):
            if isinstance(node, ast.Call):
                assert ast.unparse(node.func).rpartition(".")[2] in EXACT | TYPES | own, ast.unparse(node)
            elif isinstance(node, ast.BinOp | ast.AugAssign):
                assert isinstance(node.op, OPERATORS), ast.unparse(node)


def test_compiler_may_not_reorder_arithmetic():
    assert "fastmath" not in inspect.getsource(compiled)
    assert "parallel" not in inspect.getsource(rows)


def test_every_column_of_a_region_is_that_of_the_image():
    for name, column in COLUMNS.items():
        region = next((region for region in regions.REGIONS if name.endswith(f"_{region}")), "")
        if region and name != f"n_{region}":
            assert (column.kind, column.count) == (COLUMNS[name.removesuffix(f"_{region}")].kind, f"n_{region}")
    assert {name: column.kind for name, column in COLUMNS.items()} == rows.ROW_SCHEMA
    assert {COLUMNS[name].kind for name in COLUMNS if name.endswith("_sum")} == {pl.Float64}

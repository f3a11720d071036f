"""Export a run's results to other programs' formats, and detect files that were changed afterwards."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml

from robustflow.api import Result, evaluate, load_run
from robustflow.core.errors import UsageError
from robustflow.report.exchange import check_exported, hub_results
from robustflow.run.records.pack import pack
from robustflow.run.records.verify import Verification, verify
from robustflow.run.run import rows_bytes
from tests.made_rows import made_run
from tests.refusals import refusal

from ..stats.simulated import Truth, intervals, rows_of

HOSTILE = '<img src=x onerror=alert(1)>|`*R*`: "y" # {z} [l](javascript:x)'
HUB = "someone/kitti-fc"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Result:
    folder = tmp_path_factory.mktemp("exchange") / "run"
    return evaluate("farneback", "demo", output=folder, corruptions=["contrast"], severities=[1], name=HOSTILE)


@pytest.fixture(scope="module")
def record(run, tmp_path_factory) -> Path:
    return pack(run, tmp_path_factory.mktemp("record") / "run.robustflow")


def exported(run: Result, folder: Path) -> dict[str, Path]:
    """The results and the rows of a run, written as by `export`."""
    paths = {"huggingface": folder / "robustflow.yaml", "csv": folder / "rows.csv"}
    paths["huggingface"].write_bytes(hub_results(run, HUB))
    paths["csv"].write_bytes(rows_bytes(run, "csv"))
    return paths


@pytest.fixture(scope="module")
def loaded(record) -> Result:
    return load_run(record)


def compared(record: Path, *paths: Path) -> Verification:
    return verify(record, exported=partial(check_exported, paths=paths))


def test_intervals_are_those_of_the_tables(run):
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(40, int))
    imaginary = made_run(run, rows_of(clean, corrupted, corrupted))
    notes = {entry["dataset"]["task_id"]: entry["notes"] for entry in yaml.safe_load(hub_results(imaginary, HUB))}
    known = intervals(imaginary.rows, corruptions=False).filter(measure="rcre", condition="average")
    assert notes["rcre"].startswith(f"95 % interval {known['low'].item():.4g} to {known['high'].item():.4g}. ")


def test_yaml_of_the_hub_keeps_numbers_and_names(run):
    entries = yaml.safe_load(hub_results(run, HUB))
    values = {entry["dataset"]["task_id"]: entry["value"] for entry in entries}
    assert values == {name: getattr(run, name) for name in ("epe_clean", "epe", "cre", "crer", "rcre")}
    for entry in entries:
        assert set(entry) == {"dataset", "value", "date", "evaluation_framework", "notes"}
        assert entry["dataset"]["id"] == HUB
        assert HOSTILE in entry["notes"]
        assert "too few independent pairs (1 pairs)" in entry["notes"]


@pytest.mark.parametrize("dataset", [None, "kitti", "a/b\n  value: 0", 'a/"b"'])
def test_name_that_the_hub_does_not_allow_is_refused(run, dataset):
    refusal(lambda: hub_results(run, dataset), UsageError, "--hub-dataset")


@pytest.mark.parametrize("format", ["csv", "huggingface"])
def test_exported_file_is_confirmed_by_its_record_and_a_changed_digit_is_refused(run, record, loaded, tmp_path, format):
    path = exported(run, tmp_path)[format]
    assert compared(record, path).ok
    (tmp_path / "loaded").mkdir()
    assert exported(loaded, tmp_path / "loaded")[format].read_bytes() == path.read_bytes()
    text = path.read_text()
    digit = re.search(r"\d(?=\D*\n?$)", text) if format == "csv" else re.search(r"(?<=\.)\d", text)
    path.write_text(text[: digit.start()] + str((int(digit[0]) + 1) % 10) + text[digit.end() :])
    changed = compared(record, path)
    assert not changed.ok
    line = 1 + text[: digit.start()].count("\n")
    assert re.match(rf"exported: {re.escape(str(path))}: \w+ {line}: ", changed.first_failure())


def test_exported_file_with_an_impossible_hub_name_fails_the_check_in_one_line(record, tmp_path):
    path = tmp_path / "robustflow.yaml"
    path.write_bytes(b'- dataset:\n    id: "\\q/\xff"\n')
    assert compared(record, path).first_failure().startswith(f"exported: {path}: ")


def test_run_without_any_mean_has_no_results(run):
    nothing = dict.fromkeys(("n_valid", "n_all"), 0)
    empty = made_run(run, run.rows.with_columns(**{name: pl.lit(value, pl.Int64) for name, value in nothing.items()}))
    assert hub_results(empty, HUB) == b""

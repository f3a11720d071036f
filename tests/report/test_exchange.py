"""Export a run's results to other programs' formats, and detect files that were changed afterwards."""

from __future__ import annotations

import hashlib
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml

from robustflow.api import Result, evaluate, load_run
from robustflow.core.errors import UsageError
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.report.exchange import EXCHANGE_FORMATS, check_exported, exchange_files
from robustflow.run.records.pack import pack
from robustflow.run.records.verify import Verification, verify
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


def exported(run: Result, format: str, folder: Path) -> list[Path]:
    """The files of one format, written in the same way as by `export`."""
    paths = []
    for name, data in exchange_files(run, format, HUB).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        paths.append(path)
    return paths


@pytest.fixture(scope="module")
def loaded(record) -> Result:
    return load_run(record)


def compared(record: Path, *paths: Path) -> Verification:
    return verify(record, exported=partial(check_exported, paths=paths))


def test_intervals_are_those_of_the_tables(run, tmp_path):
    clean, corrupted = Truth().draw(np.random.default_rng(0), np.ones(40, int))
    imaginary = made_run(run, rows_of(clean, corrupted, corrupted))
    (path,) = exported(imaginary, "huggingface", tmp_path)
    notes = {entry["dataset"]["task_id"]: entry["notes"] for entry in yaml.safe_load(path.read_text())}
    known = intervals(imaginary.rows, corruptions=False).filter(measure="rcre", condition="average")
    assert notes["rcre"].startswith(f"95 % interval {known['low'].item():.4g} to {known['high'].item():.4g}. ")


def test_yaml_of_the_hub_keeps_numbers_and_names(run, tmp_path):
    (path,) = exported(run, "huggingface", tmp_path)
    entries = yaml.safe_load(path.read_text())
    values = {entry["dataset"]["task_id"]: entry["value"] for entry in entries}
    assert values == {name: getattr(run, name) for name in ("epe_clean", "epe", "cre", "crer", "rcre")}
    assert path.relative_to(tmp_path) == Path(".eval_results/robustflow.yaml")
    for entry in entries:
        assert set(entry) == {"dataset", "value", "date", "evaluation_framework", "notes"}
        assert entry["dataset"]["id"] == HUB
        assert HOSTILE in entry["notes"]
        assert "too few pairs for a bootstrap (1)" in entry["notes"]


@pytest.mark.parametrize("dataset", [None, "kitti", "a/b\n  value: 0", 'a/"b"'])
def test_name_that_the_hub_does_not_allow_is_refused(run, dataset):
    refusal(lambda: exchange_files(run, "huggingface", dataset), UsageError, "--hub-dataset")


def test_croissant_describes_the_rows_beside_it(run, tmp_path):
    metadata, rows = exported(run, "croissant", tmp_path)
    content = json.loads(metadata.read_text())
    (file,) = content["distribution"]
    assert file["sha256"] == hashlib.sha256(rows.read_bytes()).hexdigest()
    (fields,) = (one["field"] for one in content["recordSet"])
    assert [field["name"] for field in fields] == list(ROW_SCHEMA) == rows.read_text().split("\n")[0].split(",")


def test_croissant_is_valid_and_its_loader_reads_the_rows(run, tmp_path):
    mlcroissant = pytest.importorskip(
        "mlcroissant", reason="needs mlcroissant, which no extra includes because it takes 370 MB with its dependencies"
    )
    metadata, _ = exported(run, "croissant", tmp_path)
    dataset = mlcroissant.Dataset(metadata)
    assert not dataset.metadata.issues.errors
    records = list(dataset.records("rows"))
    assert [one["rows/epe_sum"] for one in records] == run.rows.sort("sample", "corruption")["epe_sum"].to_list()


@pytest.mark.parametrize("format", EXCHANGE_FORMATS)
def test_exported_file_is_confirmed_by_its_record_and_a_changed_digit_is_refused(run, record, loaded, tmp_path, format):
    paths = exported(run, format, tmp_path)
    assert compared(record, *paths).ok
    assert exchange_files(loaded, format, HUB) == exchange_files(run, format, HUB)
    for path in paths:
        text = path.read_text()
        digit = re.search(r"\d(?=\D*\n?$)", text) if path.suffix == ".csv" else re.search(r"(?<=\.)\d", text)
        path.write_text(text[: digit.start()] + str((int(digit[0]) + 1) % 10) + text[digit.end() :])
        found = compared(record, path)
        assert not found.ok
        line = 1 + text[: digit.start()].count("\n")
        assert re.match(rf"exported: {re.escape(str(path))}: \w+ {line}: ", found.first_failure())


def test_exported_file_with_an_impossible_hub_name_fails_the_check_in_one_line(record, tmp_path):
    path = tmp_path / "robustflow.yaml"
    path.write_bytes(b'- dataset:\n    id: "\\q/\xff"\n')
    assert compared(record, path).first_failure().startswith(f"exported: {path}: ")


def test_run_without_any_mean_has_no_results(run):
    nothing = dict.fromkeys(("n_valid", "n_all"), 0)
    empty = made_run(run, run.rows.with_columns(**{name: pl.lit(value, pl.Int64) for name, value in nothing.items()}))
    assert list(exchange_files(empty, "huggingface", HUB).values()) == [b""]

"""Rows of attacks in a record are read back, and a forged row is detected."""

from __future__ import annotations

import polars as pl
import pytest

from robustflow.api import evaluate, load_run
from robustflow.metrics.rows import ROW_KEY, ROW_SCHEMA
from robustflow.report.tables import tables_of
from robustflow.run.records.pack import record_bytes

from .forge import assert_fails, at, failure, verified, with_json, with_rows

pytestmark = pytest.mark.usefixtures("demo_is_small")

_SQUARE = pl.col("corruption") == "square:queries=3"


@pytest.fixture(scope="module")
def attacked_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attacked") / "run"
    chosen = {"corruptions": "contrast", "severities": 1, "attacks": "square:queries=3"}
    return evaluate("dis", "demo", output=folder, **chosen)


@pytest.fixture(scope="module")
def attacked(attacked_run) -> bytes:
    return record_bytes(attacked_run)


def test_runs_of_attacks_alone_are_packed_and_compared_in_a_table(tmp_path):
    runs = [
        evaluate("dis", "shapes", output=tmp_path / str(number), attacks="random_patch", severities=number,
                 data_options={"pairs": number, "size": "32x48"})
        for number in (1, 2)
    ]  # fmt: skip
    assert verified(record_bytes(runs[0])).ok
    (table,) = tables_of(runs, published=False, wanted=["security"])
    assert "severity 1, 1 pair" in table.remarks[-1]
    assert "severity 2, 2 pairs" in table.remarks[-1]


def test_a_record_holds_the_rows_of_attacks(attacked_run, attacked, tmp_path):
    found = verified(attacked)
    (tmp_path / "run.robustflow").write_bytes(attacked)
    loaded = load_run(tmp_path / "run.robustflow")

    assert found.ok, found.first_failure()
    assert len(found.unproven) == 4
    assert loaded.attack_rows.sort(ROW_KEY).equals(attacked_run.attack_rows.sort(ROW_KEY))
    assert loaded.rows.sort(ROW_KEY).equals(attacked_run.rows.sort(ROW_KEY))
    assert loaded.means == attacked_run.means


@pytest.mark.parametrize(
    "change", [{"attack_warnings": "fine"}, {"attack_gradient": "steep"}, {"attack_evaluations": -1}]
)
def test_a_forged_row_of_an_attack_is_detected(attacked, change):
    values = {name: pl.lit(value, ROW_SCHEMA[name]) for name, value in change.items()}
    assert_fails(with_rows(attacked, at(_SQUARE, **values)), "rows")


def test_attacks_that_are_missing_or_unknown_are_detected(attacked):
    def attacks(names):
        return lambda manifest: manifest["planned"][0].update(attacks={name: [1] for name in names})

    kept = ["random_sign", "random_gauss", "square:queries=3"]
    assert failure(with_rows(attacked, lambda rows: rows.filter(~_SQUARE)))[0] == "cells"
    assert failure(with_json(attacked, "manifest.json", attacks(kept[1:])))[0] == "cells"
    assert failure(with_json(attacked, "manifest.json", attacks([*kept, "os:system"])))[0] == "manifest"

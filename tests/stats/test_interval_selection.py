"""Intervals of averages alone, and of families of one corruption, equal those computed with all corruptions."""

from __future__ import annotations

import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.stats.uncertainty import intervals


@pytest.fixture(scope="module")
def demo_rows(tmp_path_factory) -> pl.DataFrame:
    chosen = {"corruptions": ["contrast", "fog"], "severities": [1, 5]}
    return evaluate("dis", "demo", output=tmp_path_factory.mktemp("demo") / "dis", **chosen).rows


def test_intervals_of_averages_alone_equal_those_computed_with_all(structured_rows):
    whole = intervals(structured_rows)
    few = intervals(structured_rows, corruptions=False)
    averages = whole.filter(pl.col("corruption").is_in(["average", "clean"]))
    assert few.height == 5
    assert few.drop("standard_error", "low", "high").equals(averages.drop("standard_error", "low", "high"))
    for name in ("standard_error", "low", "high"):
        assert few[name].to_list() == pytest.approx(averages[name].to_list(), rel=1e-12)


@pytest.fixture(scope="module")
def structured_rows(demo_rows):
    """Ten pairs with different errors."""
    rows = demo_rows
    totals = [name for name in rows.columns if "epe_sum" in name or ("rcre" in name and "sum" in name)]
    return pl.concat(
        rows.with_columns(
            pl.lit(f"pair {index}").alias("sample"),
            pl.lit(f"pair {index}").alias("group"),
            *(pl.col(name) * (1 + 0.1 * index) for name in totals),
        )
        for index in range(10)
    )


def test_the_interval_of_a_family_is_that_of_its_only_corruption(structured_rows):
    """Contrast is the only digital corruption here, and fog the only weather corruption; families without any
    corruption have no interval.
    """
    made = intervals(structured_rows, families=True)
    for family, corruption in (("digital", "contrast"), ("weather", "fog")):
        for metric in ("epe", "cre", "crer", "rcre"):
            of_family, of_one = (made.filter(metric=metric, corruption=name) for name in (family, corruption))
            assert of_family["estimate"].to_list() == pytest.approx(of_one["estimate"].to_list())
            assert of_family["low"].to_list() == pytest.approx(of_one["low"].to_list())
    assert made.filter(corruption="noise").is_empty()

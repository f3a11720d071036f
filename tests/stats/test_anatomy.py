"""The error breakdown is correct for rows with known components."""

from __future__ import annotations

from functools import partial

import polars as pl
import pytest

from robustflow.run.summary import summarize
from robustflow.stats.anatomy import error_parts, severity_slopes
from tests.made_rows import rows_frame
from tests.run.mean_rows import row

_row = partial(row, "a", n=100)


def _summary(*rows: dict):
    return summarize(rows_frame(rows))


def test_families_share_the_error():
    """Two weather corruptions have CRE 6 and one noise corruption has CRE 3: weather adds 4 px to the mean of 5 px."""
    corrupted = {"fog": (8.0, 10), "snow": (8.0, 20), "gaussian_noise": (5.0, 7)}
    rows = [_row(name, 1, epe=epe, fl_count=fl) for name, (epe, fl) in corrupted.items()]
    weather, noise = error_parts(_summary(_row(epe=2.0, fl_count=5), *rows))
    assert (weather.label, weather.cre, weather.crer) == ("weather corruptions", 6, 3)
    assert (weather.contribution, noise.contribution) == pytest.approx((4, 1))
    assert (weather.broken, noise.broken) == pytest.approx((10, 2))


def test_slope_of_a_corruption_is_the_growth_of_its_epe_per_severity():
    rows = [_row(epe=1.0), _row("spatter", 1, epe=7.0)]
    for s in range(1, 6):
        rows += [_row("fog", s, epe=1 + 0.5 * s), _row("snow", s, epe=s**2), _row("frost", s, epe=7 - s)]
    assert severity_slopes(_summary(*rows), "epe") == pytest.approx({"fog": 0.5, "snow": 6, "frost": -1})


def test_region_shares_and_scores_equal_hand_computed_values():
    clean, fog = (
        {"n_d0_10": 10, "epe_sum_d0_10": 10 * epe, "rcre_sum_d0_10": 0.0, "fl_count_d0_10": 5} for epe in (4.0, 20.0)
    )
    region = error_parts(_summary(_row(epe=2.0, fl_count=5, **clean), _row("fog", 1, epe=8.0, fl_count=10, **fog)))[0]
    assert region.label == "within 10 px of a motion edge"
    assert (region.share, region.cre, region.crer, region.broken) == (10, 16, 4, 0)


@pytest.mark.parametrize("lacking", ["pixels", "rows"])
def test_outliers_are_not_compared_with_those_of_other_pixels_or_images(lacking):
    other = row("b", n=100, epe=9.0, fl_count=90)
    clean, fog = _row(epe=2.0, fl_count=5), _row("fog", 1, epe=2.0, fl_count=5)
    if lacking == "pixels":
        clean, fog, other = clean | {"n_truth": 100}, fog | {"n_valid": 50, "n_truth": 100}, row("b", "fog", 1, n=100)
        rows = [clean, fog, row("b", n=100), other]
    else:
        rows = [clean, fog, other]
    summary = _summary(*rows)
    assert summary.mean("fl", "clean") is not None
    assert [part.broken for part in error_parts(summary)] == [None]


def test_error_parts_without_ground_truth_are_none():
    rows = rows_frame([_row(epe=2.0), _row("fog", 1, epe=8.0)])
    of_truth = ("n_valid", "epe_sum", "rcre_sum", "fl_count")
    blind = summarize(rows.with_columns(pl.lit(None, rows.schema[name]).alias(name) for name in of_truth))
    assert [(part.label, part.contribution) for part in error_parts(blind)] == [("weather corruptions", None)]

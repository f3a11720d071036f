"""The error breakdown is correct for rows with known components."""

from __future__ import annotations

import polars as pl
import pytest

from robustflow.analysis.anatomy import error_parts, severity_slopes
from robustflow.metrics.rows import CLEAN
from robustflow.runs.aggregate import summarize
from tests.made_rows import rows_frame

_PIXELS = 1000


def _row(corruption: str, severity: int, epe: float, fl: float, edge_epe: float | None = None) -> dict:
    row = {
        "sample": "a",
        "group": "a",
        "corruption": corruption,
        "severity": severity,
        "height": 1,
        "width": _PIXELS,
        "n_invalid": 0,
        "n_all": _PIXELS,
        "rcre_all_sum": 0.0,
        "pred_magnitude_sum": 0.0,
        "n_valid": _PIXELS,
        "epe_sum": _PIXELS * epe,
        "rcre_sum": _PIXELS * epe,
        "magnitude_sum": 0.0,
        "fl_count": round(_PIXELS * fl / 100),
        "px1_count": 0,
        "px3_count": 0,
        "px5_count": 0,
        "wauc_sum": 0.0,
    }
    if edge_epe is not None:
        row |= {"n_d0_10": 100, "epe_sum_d0_10": 100 * edge_epe, "rcre_sum_d0_10": 0.0, "fl_count_d0_10": 50}
    return row


def _summary(*rows: dict):
    return summarize(rows_frame(rows))


def test_families_share_the_error():
    """Two weather corruptions have CRE 6 and one noise corruption has CRE 3: weather adds 4 px to the mean of 5 px."""
    weather, noise = error_parts(
        _summary(_row(CLEAN, 0, 2, 5), _row("fog", 1, 8, 10), _row("snow", 1, 8, 20), _row("gaussian_noise", 1, 5, 7))
    )
    assert (weather.label, weather.cre, weather.crer) == ("weather corruptions", 6, 3)
    assert (weather.contribution, noise.contribution) == pytest.approx((4, 1))
    assert (weather.broken, noise.broken) == pytest.approx((10, 2))


def test_slopes():
    rows = [_row(CLEAN, 0, 1, 0)]
    rows += [_row("fog", s, 1 + 0.5 * s, 0) for s in range(1, 6)]
    rows += [_row("snow", s, s**2, 0) for s in range(1, 6)]
    rows += [_row("frost", s, 7 - s, 0) for s in range(1, 6)]
    rows += [_row("spatter", 1, 7, 0)]
    assert severity_slopes(_summary(*rows), "epe") == pytest.approx({"fog": 0.5, "snow": 6, "frost": -1})


def test_regions():
    summary = _summary(_row(CLEAN, 0, 2, 5, edge_epe=4.0), _row("fog", 1, 8, 10, edge_epe=20.0))
    region = error_parts(summary)[0]
    assert region.label == "within 10 px of a motion edge"
    assert (region.share, region.cre, region.crer, region.broken) == (10, 16, 4, 0)


def test_without_ground_truth_nothing_is_made_up():
    rows = rows_frame([_row(CLEAN, 0, 2, 5), _row("fog", 1, 8, 10)])
    blind = rows.with_columns(
        pl.lit(None, rows.schema[c]).alias(c) for c in ("n_valid", "epe_sum", "rcre_sum", "fl_count")
    )
    summary = summarize(blind)
    assert [(part.label, part.contribution) for part in error_parts(summary)] == [("weather corruptions", None)]

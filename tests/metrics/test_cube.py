"""The cube of a run: measures of images from their declarations, what a scope averages, and what is refused."""

import math
from statistics import fmean

import numpy as np
import polars as pl
import pytest

from robustflow.core.errors import RunError, UsageError
from robustflow.metrics.cube import Cube
from robustflow.metrics.measures import EVERY, MEASURES, REGION_MEASURES, Average, Increase, Ratio
from robustflow.stats.estimate import contrast
from tests.made_rows import rows_frame
from tests.refusals import refusal
from tests.run.mean_rows import THREE_IMAGES, row

WHOLES = {"weather": ("fog", "snow"), "noise": ("shot_noise",)}
CUBE = Cube.of(rows_frame(THREE_IMAGES), WHOLES)
EPE, CRE, CRER = (MEASURES[name] for name in ("epe", "cre", "crer"))


def test_measure_of_an_image_is_arranged_by_sample_and_condition():
    assert CUBE.conditions == (("clean", 0), ("fog", 1), ("fog", 2), ("snow", 1))
    np.testing.assert_array_equal(CUBE.images(EPE), [[1, 2, 4, 0], [3, 5, 9, 2], [8, 14, 20, 1]])
    np.testing.assert_array_equal(CUBE.images(CRE), [[np.nan, 1, 3, -1], [np.nan, 2, 6, -1], [np.nan, 6, 12, -7]])


@pytest.mark.parametrize(
    ("condition", "severity", "columns"),
    [
        ("clean", None, [[0]]),
        ("fog", None, [[1, 2]]),
        ("fog", 2, [[2]]),
        ("average", None, [[1, 2], [3]]),
        ("weather", 1, [[1], [3]]),
        ("average", 5, []),
        ("noise", None, []),
        ("unknown", None, []),
    ],
)
def test_scope_averages_severities_before_corruptions(condition, severity, columns):
    assert CUBE.scope(condition, severity, range(4)) == columns
    means = [[CUBE.mean(EPE, *CUBE.conditions[k]) if k else 4.0 for k in part] for part in columns]
    assert CUBE.mean(EPE, condition, severity) == (fmean(map(fmean, means)) if columns else None)


def test_increase_is_over_images_with_both_and_ratio_over_the_clean_mean():
    """Image c has no ground truth on the clean frames: CRE is over a and b, the clean EPE too."""
    cube = Cube.of(rows_frame(THREE_IMAGES[:2] + THREE_IMAGES[3:]))
    assert (cube.mean(EPE, "fog", 1), cube.mean(CRE, "fog", 1), cube.mean(EPE, "clean")) == (7.0, 1.5, 2.0)
    assert cube.mean(CRER, "fog", 1) == 0.75
    assert (cube.mean(CRE, "clean"), Cube.of(rows_frame(THREE_IMAGES[3:])).mean(CRE, "fog")) == (None, None)


def test_value_that_is_not_finite_makes_the_mean_of_its_condition_unknown():
    undefined = Average(
        "u", total=pl.when(pl.col("sample") != "b").then("epe_sum").otherwise(math.nan), count=pl.lit(1)
    )
    assert not any(map(math.isfinite, CUBE.known(undefined).values()))
    assert all(CUBE.mean(undefined, *at) is None for at in CUBE.scopes)
    assert np.isinf(CUBE.images(undefined)[1]).all()


@pytest.mark.parametrize(
    ("clean", "fog", "known"),
    [
        (1.0, 3.0, {"epe", "cre", "crer", "median_cre"}),
        (1e5, 1e5, {"epe", "cre", "crer", "median_cre"}),
        (1e28, 1e28, {"epe"}),
        (1.0, 1e28, {"epe"}),
        (0.003, 0.15, {"epe", "cre", "median_cre"}),
    ],
)
def test_change_that_rounding_hides_and_ratio_to_no_error_are_unknown(clean, fog, known):
    """An outlier of 1e30 px leaves a difference of 0; a mean that includes such a condition is unknown, too."""
    errors = [("clean", 0, clean), ("fog", 1, fog), ("snow", 1, clean + 1)]
    rows = rows_frame(row(f"{n}", corruption, at, epe=epe) for n in range(6) for corruption, at, epe in errors)
    cube = Cube.of(rows)
    measures = {name: EVERY[name] for name in ("epe", "cre", "crer", "median_cre")}
    for condition in ("fog", "average"):
        assert {name for name, *_ in cube.means(measures, [(condition, None)])} == known
        tests = contrast({"A": cube, "B": Cube.of(rows)}, measures, [(condition, None)])
        assert set(tests["measure"]) == known


def test_rows_of_which_few_cells_were_measured_are_refused_where_memory_matters(monkeypatch):
    rows = rows_frame([row(f"{number}", "fog", number) for number in range(1, 6)])
    assert Cube.of(rows).shape == (5, 5)
    monkeypatch.setattr("robustflow.metrics.cube._MOST_EMPTY", 1)
    refusal(lambda: Cube.of(rows), RunError, "rows")
    assert Cube.of(rows.head(4)).shape == (4, 4)


@pytest.mark.parametrize(("count", "refused"), [(2**12, False), (2**12 + 1, True)])
def test_cube_of_mostly_empty_cells_has_at_most_two_to_the_24(count, refused):
    rows = rows_frame([row("0", "fog", 1)])
    every = pl.concat([rows] * count).with_columns(
        sample=pl.arange(count).cast(pl.String), severity=pl.arange(count) + 1
    )
    if refused:
        refusal(lambda: Cube.of(every), RunError, "rows")
    else:
        assert Cube.of(every).shape == (count, count)


def test_unknown_averaging_is_refused():
    refusal(lambda: Cube.of(rows_frame(THREE_IMAGES), averaging="pixels"), UsageError, "averaging")


def test_declared_facts_fit_the_form():
    regional = [measure for measures in REGION_MEASURES.values() for measure in measures.values()]
    for measure in (*EVERY.values(), *regional):
        low, high = measure.bounds
        assert (measure.unit == "%") <= (low == 0 and high == 100) or measure is EVERY["attack_way_gone"]
        assert isinstance(measure, Increase | Ratio) <= (low < 0)
    assert [name for name, measure in EVERY.items() if measure.verdict == "leads"] == ["epe"]

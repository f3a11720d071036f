"""Models that change little because they do not look are not called robust."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from robustflow.analysis.doubts import clean_epe, doubts_from_rows, zero_flow_epe
from robustflow.analysis.uncertainty import compare_all, compare_rows

from .simulated import rows_of

_RNG = np.random.default_rng(3)
_HARD = _RNG.gamma(2, 1, 40) + 0.5


def _rows(clean: float, moved: float) -> pl.DataFrame:
    """Forty images of a motion of 50 px: a clean EPE, and by how much corruption changes error and flow."""
    return rows_of(clean * _HARD, (clean + moved) * _HARD[:, None] * np.ones(3), moved * _HARD[:, None] * np.ones(3))


_USELESS, _SOUND = _rows(31.0, 0.5), _rows(13.0, 5.0)


def test_zero_flow_is_the_bar():
    assert zero_flow_epe(_SOUND) == pytest.approx(50.0)
    assert clean_epe(_SOUND) == pytest.approx(13 * _HARD.mean())
    (reason,) = doubts_from_rows(_USELESS)
    assert reason.endswith("is not below the 50.00 px of zero flow")
    assert not doubts_from_rows(_SOUND)


def test_a_flow_that_does_not_depend_on_the_frames_is_flagged():
    (reason,) = doubts_from_rows(_rows(1.0, 0.001))
    assert reason.startswith("its flow hardly depends on the frames")
    same = _rows(1.0, 0.0).with_columns(frames_digest=pl.lit("same"))
    assert not doubts_from_rows(same), "frames that are not changed by a corruption say nothing"


def test_a_lower_cre_is_not_a_verdict_without_the_accuracy():
    lines = compare_rows(_USELESS, _SOUND, ("random", "dis"), resamples=499)
    cre = lines.filter(metric="cre", corruption="average")["sentence"].item()
    gap = 18 * _HARD.mean()
    assert cre.endswith(f"random changes less under corruption but is less accurate: EPE +{gap:.2f} px.")
    turned = compare_rows(_SOUND, _USELESS, ("dis", "random"), resamples=499)
    assert (
        turned.filter(metric="cre", corruption="average")["sentence"]
        .item()
        .endswith(f"less accurate: EPE +{gap:.2f} px.")
    )
    epe = lines.filter(metric="epe", corruption="average")["sentence"].item()
    assert epe.endswith("dis is more accurate.")
    assert not lines.filter(pl.col("sentence").str.contains("is better")).height


def test_many_models_are_compared_over_what_all_of_them_measured():
    """One run has a third of the settings: no mean over three settings stands beside a mean over one."""
    part = _rows(5.0, 2.0).filter(pl.col("corruption").is_in(["clean", "snow"]))
    lines = compare_all({"a": _USELESS, "b": _SOUND, "c": part}, resamples=99)
    values = {}
    for row in lines.iter_rows(named=True):
        for side in ("first", "second"):
            values.setdefault(row[side], set()).add(row[f"value_{side}"])
    assert {name: len(found) for name, found in values.items()} == {"a": 1, "b": 1, "c": 1}
    assert values["b"].pop() == pytest.approx(5 * _HARD.mean())

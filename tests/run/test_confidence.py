"""Runs that measure confidence have the same rows with every engine, whether resumed or not."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import ModelError, RunError
from robustflow.metrics import ause, confidence_correlation, epe_map, error_at, forward_backward
from robustflow.models import ModelRef
from robustflow.run.records.row_rules import check_rules
from robustflow.stats.numbers import confidence_means
from robustflow.testing import TexturePairs
from tests.refusals import refusal

from .models_for_tests import Sure

TEXTURES = "tests.run.test_confidence:Textures"
FAST = ("contrast", "impulse_noise")


class Textures(TexturePairs):
    def __init__(self) -> None:
        super().__init__(2)


def run(folder, model=None, confidence="forward-backward", **options):
    given = {"corruptions": FAST, "severities": [1, 4], **options}
    spec = model or ModelRef.parse("tests.run.models_for_tests:Sure")
    return rf.evaluate(spec, data=TEXTURES, output=folder, confidence=confidence, **given)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(tmp_path_factory.mktemp("confidence") / "run")


def test_rows_hold_what_the_array_functions_give(whole):
    pair, (row,) = Textures().load("0"), whole.rows.filter(sample="0", corruption="clean").to_dicts()
    flow, back = Sure().predict(*pair.frames), Sure().predict(*pair.frames[::-1])
    confidence, rejected = forward_backward(flow, back)
    errors = epe_map(flow, pair.flow)
    errors[~pair.valid] = np.nan
    assert row["ause"] == ause(errors, confidence) > 0
    assert row["confidence_spearman"] == confidence_correlation(errors, confidence)
    assert row["error_at_80"] == error_at(errors, confidence, 0.8)
    assert row["oracle_at_50"] == error_at(errors, -errors, 0.5)
    assert row["rejected_count"] == rejected.sum()
    assert whole.rows["ause"].null_count() == 0


def test_without_a_confidence_the_rest_of_a_row_is_the_same(whole, tmp_path):
    plain = run(tmp_path / "run", confidence=None)
    columns = [name for name in plain.rows.columns if plain.rows[name].null_count() < plain.rows.height]
    assert "ause" not in columns
    assert plain.rows.select(columns).equals(whole.rows.select(columns))
    assert "confidence" in str(refusal(lambda: run(tmp_path / "run"), RunError, tmp_path / "run"))


def test_backward_flow_of_equal_frames_is_not_predicted(tmp_path):
    class Counting(Sure):
        asked = 0

        def predict(self, frame1, frame2):
            Counting.asked += 1
            return super().predict(frame1, frame2)

    run(tmp_path / "run", Counting(), still=True, corruptions=["contrast", "impulse_noise"], severities=[1], limit=1)
    assert Counting.asked == 2 + 1 + 2, "the two frames are equal in clean, which is asked twice, and contrast"


def test_confidence_of_a_wrong_size_or_nan_ends_the_run_in_one_line(tmp_path):
    for spoil in ("size", "nan"):
        refusal(partial(run, tmp_path / spoil, Sure(spoil), "model", limit=1), ModelError, "sample '1', clean")


def test_rows_without_ground_truth_have_only_the_share_of_rejected_pixels(clip_folder, tmp_path):
    options = {"corruptions": FAST, "severities": [1], "limit": 1, "confidence": "forward-backward"}
    result = rf.evaluate(Sure(), "folder", clip_folder, tmp_path / "run", **options)
    assert result.rows["ause"].null_count() == result.rows.height
    assert result.rows["rejected_count"].null_count() == 0


def test_rows_with_confidence_break_no_rule(whole):
    check_rules(whole.rows)


def test_scores_are_means_over_images_by_family_and_severity(whole):
    known = confidence_means(whole.rows)
    assert {("ause", "clean", None), ("ause", "average", None), ("ause", "noise", None), ("ause", "noise", 1)} <= {
        *known
    }
    rows = whole.rows.filter(corruption="impulse_noise", severity=4)
    for measure, values in {
        "ause": rows["ause"],
        "ause_normalised": rows["ause"] * rows["n_valid"] / rows["epe_sum"],
        "rejected": 100 * rows["rejected_count"] / rows["n_all"],
        "error_at_80": rows["error_at_80"],
        "error_at_100": rows["epe_sum"] / rows["n_valid"],
    }.items():
        assert known[measure, "noise", 4] == pytest.approx(values.mean(), rel=1e-12)

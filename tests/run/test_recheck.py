"""Frames recomputed from the data equal those of the run; different data, seeds and rows are detected."""

import cv2
import numpy as np
import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.core.errors import RobustFlowError, RunError, UsageError
from robustflow.models import ModelRef
from robustflow.run.records.pack import load_any_run, pack
from robustflow.run.repeat import recheck
from robustflow.testing import ZeroClipFlow
from tests.made_rows import changed_identity

from ..refusals import refusal


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recheck") / "run"
    return evaluate("dis", "demo", output=folder, corruptions=["gaussian_noise", "fog"], severities=[1, 4], seed=3)


def test_recheck_confirms_every_row_of_a_run(run):
    result = recheck(run.manifest.identity, run.rows, count=1000)
    assert result.startswith(f"{run.rows.height} of {run.rows.height} rows")
    close = run.rows.with_columns(**_more("epe_sum", "n_valid", 0.0095))
    assert recheck(run.manifest.identity, close, model=ModelRef.parse("dis"), count=1000)


def test_recheck_draws_the_same_rows_with_a_seed_and_new_ones_without(run):
    results = [recheck(run.manifest.identity, run.rows, count=1, seed=seed) for seed in (1, 1, None, None)]
    assert results[0] == results[1]
    assert len(set(results[1:])) == 3


def _more(total: str, count: str, pixels: float) -> dict[str, pl.Expr]:
    return {total: pl.col(total) + pixels * pl.col(count)}


WITHOUT_MODEL = [
    ({"frames_digest": pl.lit("0" * 32)}, "frames"),
    ({"height": pl.col("height") + 1}, "frames"),
    ({"magnitude_sum": pl.col("magnitude_sum") * 0.999}, "ground truth"),
    ({"n_valid": pl.col("n_valid") - 1}, "ground truth"),
    ({"n_s40": pl.col("n_s40") + 1}, "ground truth"),
    ({"truth_digest": pl.lit("0" * 32)}, "ground truth"),
    ({"truth": pl.lit("none")}, "ground truth"),
    ({"group": pl.lit("all the same")}, "group"),
]
WITH_MODEL = [
    _more("epe_sum", "n_valid", 0.0105),
    _more("rcre_all_sum", "n_all", 0.0105),
    _more("pred_magnitude_sum", "n_all", -0.0105),
    _more("photometric_sum", "n_photometric", 0.0105),
    {"spread_sum": pl.lit(0.0)},
    {"n_all": pl.lit(0), "n_valid": pl.lit(0), "epe_sum": 0.0, "rcre_all_sum": 0.0},
]


@pytest.mark.parametrize(
    ("change", "what", "model"),
    [*((*case, None) for case in WITHOUT_MODEL), *((change, "flow", ModelRef.parse("dis")) for change in WITH_MODEL)],
)
def test_recheck_finds_changed_rows(run, change, what, model):
    def check(rows):
        return recheck(run.manifest.identity, rows, model=model, count=1000)

    error = refusal(lambda: check(run.rows.with_columns(**change)), RunError, "sample 'motorcycle', clean")
    assert what in str(error)


@pytest.mark.parametrize("change", [{"name": "farneback"}, {"checkpoint": "0" * 64}])
def test_recheck_with_another_model_than_the_run_names_is_refused(run, change):
    identity = changed_identity(run.manifest.identity, {**run.manifest.identity.model.settings, **change})
    culprit = f"{next(iter(change))} of the model"
    refusal(lambda: recheck(identity, run.rows, model=ModelRef.parse("dis"), count=1), RunError, culprit)


def test_recheck_with_other_options_of_the_model_names_them_and_not_the_data(run):
    def check():
        return recheck(
            run.manifest.identity, run.rows, model=ModelRef.parse("dis", {"preset": "ultrafast"}), count=1000
        )

    error = refusal(check, RunError, "sample 'motorcycle', clean")
    assert "preset is medium, here ultrafast" in str(error)
    assert "these data" not in str(error)


def test_recheck_names_an_unknown_sample(run):
    rows = run.rows.with_columns(sample=pl.lit("../../etc/passwd"))
    refusal(lambda: recheck(run.manifest.identity, rows, count=2), RunError, "../../etc/passwd")


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"variant": "reference"},
        {"protocol": {"frames": "released"}},
        {"dataset": "kitti2015"},
        {"severity_scale": "calibrated 0000"},
        {"psf": "reference 00"},
        {"streams": 1},
    ],
)
def test_recheck_finds_changed_identities(run, change):
    noise = run.rows.filter(corruption="gaussian_noise")
    with pytest.raises(RunError):
        recheck(changed_identity(run.manifest.identity, **change), noise)


def test_recheck_of_different_frames_with_the_same_names_fails(tmp_path):
    rng = np.random.default_rng(0)
    for folder in ("mine", "other"):
        (tmp_path / folder).mkdir()
        for index in range(3):
            cv2.imwrite(str(tmp_path / folder / f"{index}.png"), rng.integers(0, 255, (40, 60, 3), np.uint8))
    found = evaluate(
        "dis", "folder", tmp_path / "mine", tmp_path / "run", corruptions=["contrast", "snow"], severities=[2]
    )
    identity = found.manifest.identity
    assert "6 of 6" in recheck(identity, found.rows, tmp_path / "mine")
    error = refusal(lambda: recheck(identity, found.rows, tmp_path / "other"), RunError, "sample '0', clean")
    assert str(error).count(" 6 ") == 2
    with pytest.raises(RunError):
        recheck(identity, found.rows, tmp_path / "mine", options={"step": 2})
    independent = found.rows.with_columns(group=pl.col("sample"))  # would narrow every confidence interval
    error = refusal(lambda: recheck(identity, independent, tmp_path / "mine"), RunError, "sample '0', clean")
    assert str(error).count(" 6 ") == 2


def test_a_multi_frame_run_packs_and_its_pairs_are_rechecked(tmp_path):
    """The digest in a row covers only the pair, not the entire clip."""
    (tmp_path / "frames").mkdir()
    for index in range(4):
        frame = np.random.default_rng(index).integers(0, 255, (24, 32, 3), np.uint8)
        cv2.imwrite(str(tmp_path / "frames" / f"{index}.png"), frame)
    options = {"corruptions": ["snow"], "severities": [2]}
    found = evaluate(ZeroClipFlow((1, 0)), "folder", tmp_path / "frames", tmp_path / "run", **options)
    assert found.manifest.identity.model.window
    packed = load_any_run(pack(found, tmp_path / "a.robustflow"))
    assert "6 of 6" in recheck(packed.manifest.identity, packed.rows, tmp_path / "frames")


def test_invalid_arguments_of_recheck_are_refused(run):
    refusal(lambda: recheck(run.manifest.identity, run.rows, count=0), UsageError, "--check-frames")
    with pytest.raises(RobustFlowError):
        recheck(changed_identity(run.manifest.identity, benchmark="../x"), run.rows)

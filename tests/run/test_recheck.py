"""Frames recomputed from the data equal those of the run; different data, seeds and rows are detected."""

import cv2
import numpy as np
import polars as pl
import pytest

from robustflow.api import evaluate
from robustflow.core.errors import RobustFlowError, RunError, UsageError
from robustflow.models import ModelSpec
from robustflow.run.recheck import recheck
from robustflow.run.records.pack import load_any_run, pack
from robustflow.testing import ZeroClipFlow
from tests.made_rows import changed_identity


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recheck") / "run"
    return evaluate("dis", "demo", output=folder, corruptions=["gaussian_noise", "fog"], severities=[1, 4], seed=3)


def test_recheck_confirms_every_row_of_a_run(run):
    result = recheck(run.manifest.identity, run.rows, count=1000)
    assert result.startswith(f"{run.rows.height} of {run.rows.height} rows")


def test_recheck_needs_no_temporary_folder(run, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "/no such folder")
    recheck(run.manifest.identity, run.rows, count=1)


def test_recheck_draws_the_same_rows_with_a_seed_and_new_ones_without(run):
    results = [recheck(run.manifest.identity, run.rows, count=1, seed=seed) for seed in (1, 1, None, None)]
    assert results[0] == results[1]
    assert len(set(results[1:])) == 3


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"frames_digest": pl.lit("0" * 32)}, "different frames"),
        ({"magnitude_sum": pl.col("magnitude_sum") * 0.999}, "different ground truth"),
        ({"n_valid": pl.col("n_valid") - 1}, "different ground truth"),
        ({"truth_digest": pl.lit("0" * 32)}, "different ground truth"),
        ({"group": pl.lit("all the same")}, "different group"),
        ({"sample": pl.lit("../../etc/passwd")}, "has no sample '../../etc/passwd'"),
    ],
)
def test_recheck_finds_changed_rows(run, change, says):
    rows = run.rows.with_columns(**change)
    with pytest.raises(RunError, match=says):
        recheck(run.manifest.identity, rows, count=2)


def test_recheck_finds_rows_without_a_valid_pixel(run):
    size = pl.col("height").cast(pl.Int64) * pl.col("width")
    rows = run.rows.with_columns(n_all=pl.lit(0), n_valid=pl.lit(0), n_invalid=size, epe_sum=0.0, rcre_all_sum=0.0)
    with pytest.raises(RunError, match=r"1 of 1 rows do not match .*: this model's error differs by inf"):
        recheck(run.manifest.identity, rows, model=ModelSpec("dis"), count=1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": 4}, "gaussian_noise severity 1: different frames"),
        ({"variant": "reference"}, "different frames"),
        ({"protocol": {"frames": "released"}}, "data options of the run"),
        ({"dataset": "kitti2015"}, "data options of the run"),
        ({"severity_scale": "calibrated 0000"}, "severity_scale: calibrated 0000, here .* use the version of the run"),
        ({"psf": "reference 00"}, "set ROBUSTFLOW_PSF_DIR to the same value as for the run"),
        ({"streams": 1}, "use the version of the run"),
    ],
)
def test_recheck_finds_changed_identities(run, change, says):
    noise = run.rows.filter(corruption="gaussian_noise")
    with pytest.raises(RunError, match=says):
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
    assert "6 of 6 rows" in recheck(identity, found.rows, tmp_path / "mine")
    with pytest.raises(RunError, match="6 of 6 rows do not match these data"):
        recheck(identity, found.rows, tmp_path / "other")
    with pytest.raises(RunError, match="use the data"):
        recheck(identity, found.rows, tmp_path / "mine", options={"step": 2})
    independent = found.rows.with_columns(group=pl.col("sample"))  # would narrow every confidence interval
    with pytest.raises(RunError, match=r"6 of 6 rows do not match .*: different group"):
        recheck(identity, independent, tmp_path / "mine")


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
    assert "6 of 6 rows" in recheck(packed.manifest.identity, packed.rows, tmp_path / "frames")


def test_invalid_arguments_of_recheck_are_refused(run):
    with pytest.raises(UsageError, match="must be at least 1"):
        recheck(run.manifest.identity, run.rows, count=0)
    with pytest.raises(RobustFlowError, match="is unknown: neither this package"):
        recheck(changed_identity(run.manifest.identity, benchmark="../x"), run.rows)


def test_recheck_confirms_rows_of_real_pairs(shared, tmp_path):
    data = shared("data/kitti2015")
    found = evaluate(
        "dis", "kitti-fc", data, tmp_path / "run", corruptions=["snow"], severities=[3], limit=2, variant="reference"
    )
    assert recheck(found.manifest.identity, found.rows, data).startswith(f"{found.rows.height} of")

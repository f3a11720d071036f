"""The experiment from the command line: a complete run, and a run resumed after an interruption."""

import pytest
from typer.testing import CliRunner

from robustflow.cli.main import app
from robustflow.core.errors import RunError, UsageError

from ..refusals import refusal

_SMALL = ["--steps", "2", "--shapes", "2", "--size", "64x96", "--seeds", "1", "--loaders", "0"]


@pytest.mark.slow
@pytest.mark.torch
@pytest.mark.training
def test_the_experiment_runs_from_random_starts_to_findings_and_repeats_nothing(tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.paper.experiment.robust_training import claimed
    from robustflow.training.checkpoint import read_progress

    run = CliRunner().invoke
    command = ["reproduce", "experiment", "-o", str(tmp_path / "out")]
    first = run(app, command + _SMALL)
    assert first.exit_code == 0, first.output
    # after two updates, the network is no better than zero flow, so no conclusion may be drawn
    assert "difference" not in (tmp_path / "out/findings.md").read_text()
    folders = {arm: tmp_path / f"out/trainings/seed-0/{arm}" for arm in ("plain", "all", "no_noise", "no_weather")}
    starts = {read_progress(folder / "last.pth")[1].identity["start"] for folder in folders.values()}
    assert len(starts) == 1
    weights = {arm: (folder / "last.pth").read_bytes() for arm, folder in folders.items()}
    assert run(app, command + _SMALL).exit_code == 0
    assert {arm: (folder / "last.pth").read_bytes() for arm, folder in folders.items()} == weights
    longer = run(app, [*command, "--steps", "3", *_SMALL[2:]])
    assert isinstance(longer.exception, RunError)
    assert "--steps" in str(longer.exception)
    with claimed(folders["plain"]) as mine, claimed(folders["plain"]) as others:
        assert (mine, others) == (True, False)


@pytest.mark.torch
def test_a_dataset_given_twice_is_refused(tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.paper.experiment.robust_training import evaluation_sets

    refusal(
        lambda: evaluation_sets([f"kitti2015={tmp_path}", f"kitti2015={tmp_path}"], 2, "64x96"), UsageError, "--data"
    )


@pytest.mark.torch
@pytest.mark.parametrize(
    ("options", "culprit"), [(["--loaders", "-1"], "loaders"), (["-o", "~nobody_here/out"], "~nobody_here")]
)
def test_options_that_no_experiment_can_use_are_refused(options, culprit):
    pytest.importorskip("torch", reason="needs the torch extra")

    result = CliRunner().invoke(app, ["reproduce", "experiment", *options], env={"COLUMNS": "200"})

    assert result.exit_code != 0
    assert culprit in f"{result.output} {result.exception}"

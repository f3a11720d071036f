"""The experiment from the command line: complete, and continued where it was stopped."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from robustflow.cli.main import app
from robustflow.errors import RunError

_SMALL = ["--steps", "2", "--shapes", "2", "--size", "64x96", "--seeds", "1", "--loaders", "0"]


@pytest.mark.slow
@pytest.mark.torch
@pytest.mark.training
def test_from_start_to_findings_and_once_more(tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    run = CliRunner().invoke
    start = ["train", "tiny", "--recipe", "shapes", "--steps", "2", "--loaders", "0", "-o", str(tmp_path / "start")]
    assert run(app, start).exit_code == 0
    command = ["experiment", "robust-training", "--init", str(tmp_path / "start/last.pth"), "-o", str(tmp_path / "out")]
    first = run(app, command + _SMALL)
    assert first.exit_code == 0, first.output
    # After two updates the network is no better than zero flow, and nothing may be concluded.
    assert "Nothing is compared here" in (tmp_path / "out/findings.md").read_text()
    weights = (tmp_path / "out/trainings/seed-0/all/last.pth").read_bytes()
    effects = (tmp_path / "out/effects.csv").read_bytes()
    assert run(app, command + _SMALL).exit_code == 0
    assert (tmp_path / "out/trainings/seed-0/all/last.pth").read_bytes() == weights
    assert (tmp_path / "out/effects.csv").read_bytes() == effects
    longer = run(app, [*command, *_SMALL, "--steps", "3"])
    assert isinstance(longer.exception, RunError)
    assert "holds an experiment with another --steps" in str(longer.exception)
    start[-1] = str(tmp_path / "other")
    assert run(app, [*start, "--seed", "1"]).exit_code == 0
    command[3] = str(tmp_path / "other/last.pth")
    other = run(app, command + _SMALL)
    assert "holds an experiment with another --init" in str(other.exception)


def test_without_weights_to_begin_with(tmp_path):
    pytest.importorskip("torch", reason="needs the torch extra")
    from robustflow.errors import UsageError

    with pytest.raises(UsageError, match="no such file"):
        CliRunner().invoke(
            app, ["experiment", "robust-training", "--init", str(tmp_path / "no.pth")], catch_exceptions=False
        )

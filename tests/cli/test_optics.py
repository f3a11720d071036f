"""Test the command `robustflow optics`."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from robustflow.cli.optics import app
from robustflow.errors import DataError, UsageError
from robustflow.lenses import design as design_module
from robustflow.lenses.search import Budget
from robustflow.lenses.shipped import shipped_lens
from robustflow.psf.shipped import shipped_field

SMALL = Budget(structures=30, screened=2, pool=2, moves=2, first_iterations=3, iterations=2, last_iterations=2)


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.slow
def test_design_writes_a_prescription(tmp_path, monkeypatch):
    search = design_module.design
    monkeypatch.setattr(design_module, "design", lambda severity, seed, report: search(severity, seed, SMALL, report))
    path = tmp_path / "lens.json"
    result = invoke("design", "--severity", 2, "--seed", 3, "--output", path)
    assert result.exit_code == 0, result.output
    assert "found: | " in result.output
    assert json.loads(path.read_text())["name"] == "severity 2, seed 3"


def test_show_writes_png_and_pdf(tmp_path):
    result = invoke("show", "--severity", "2", "--output", tmp_path / "figures")
    assert result.exit_code == 0, result.output
    names = sorted(file.name for file in (tmp_path / "figures").iterdir())
    assert names == [f"{name}{end}" for name in ("lens_s2", "psf_profile", "psf_sheet") for end in (".pdf", ".png")]


def test_render_says_that_the_psfs_are_as_shipped():
    result = invoke("render", "--severity", 2)
    assert result.exit_code == 0, result.output
    assert result.output.strip() == "severity 2: as shipped"


def test_render_of_an_own_prescription(tmp_path):
    (tmp_path / "lens.json").write_text(shipped_lens(2).model_dump_json())
    result = invoke("render", "--lens", tmp_path / "lens.json", "--output", tmp_path / "psf.npy")
    assert result.exit_code == 0, result.output
    stack = np.load(tmp_path / "psf.npy")
    assert np.abs(stack - shipped_field(2).stack).max() < 1e-4


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [
        (["render", "--lens", "lens.json"], UsageError),
        (["render", "--severity", "7"], UsageError),
        (["show", "--severity", "x"], UsageError),
        (["design", "--severity", "0"], UsageError),
        (["show", "--lens", "/nowhere/lens.json"], DataError),
    ],
)
def test_wrong_arguments_are_known_errors(arguments, kind):
    assert isinstance(invoke(*arguments).exception, kind)


def test_the_main_command_mounts_it(monkeypatch, capsys):
    from robustflow.cli.main import main

    monkeypatch.setattr("sys.argv", ["robustflow", "optics", "render", "--severity", "9"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert "severity 9 does not exist" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["show", "render"])
def test_no_severity_is_one_sentence(robustflow, command):
    code, _, err = robustflow("optics", command, "--severities", "")
    assert (code, err) == (2, "robustflow: --severities is empty; give one or more of 1 to 5, separated by commas\n")

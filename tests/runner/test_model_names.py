"""The names of models are shown everywhere and do not affect any results."""

import sys

import pytest

import robustflow as rf
from robustflow.cli.main import main
from robustflow.errors import UsageError
from robustflow.models.catalog import methods
from robustflow.records.pack import pack
from robustflow.report.site.content import run_content
from robustflow.testing import ZeroFlow

SETTINGS = {"corruptions": ["contrast"], "severities": [1]}


class Still(ZeroFlow):
    name = "My model"


def test_the_attribute_and_the_argument(tmp_path, real_pictures):
    with real_pictures():
        result = rf.evaluate(Still(), output=tmp_path / "run", **SETTINGS)
    assert result.name == "My model"
    assert "My model" in (tmp_path / "run" / "report.html").read_text()
    before = result.manifest.identity_digest
    again = rf.evaluate(Still(), output=tmp_path / "run", name="Another", corruptions=["contrast"], severities=[1, 2])
    assert (again.name, again.manifest.identity_digest) == ("Another", before)
    assert "My model" not in str(again.manifest.identity)
    record = tmp_path / "a.robustflow"
    pack(again, record)
    assert rf.load_run(record).name == "Another"


@pytest.mark.parametrize("name", ["", "  ", "x" * 81, "two\nlines"])
def test_names_that_cannot_be_shown(tmp_path, name):
    with pytest.raises(UsageError, match="the name of a model must be 1 to 80 printable characters"):
        rf.evaluate(Still(), output=tmp_path / "run", name=name, **SETTINGS)


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["robustflow", "run", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code


def test_on_the_command_line(tmp_path, monkeypatch, capsys):
    options = ["-m", "dis", "-c", "contrast", "-s", "1", "--no-examples", "-o", str(tmp_path / "run")]
    assert run(monkeypatch, *options, "--name", "DIS, ours") in (0, None)
    assert "DIS, ours" in capsys.readouterr().out
    assert run(monkeypatch, *options) in (0, None)
    assert rf.load_run(tmp_path / "run").name == "DIS, ours", "the name is kept by a later call without one"


def test_one_label_for_one_model_everywhere(tmp_path, monkeypatch, capsys):
    """A method has the same label in `list models` and in the tables of runs; no two methods share a label."""
    labels = [entry.method for entry in methods().values()]
    assert len(set(labels)) == len(labels)
    monkeypatch.setattr(sys, "argv", ["robustflow", "list", "models"])
    with pytest.raises(SystemExit):
        main()
    listed = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines()[1:6])
    for model, label in (("dis", "DIS"), ("dis_rgb", "DIS-RGB"), ("farneback", "Farneback")):
        assert run(monkeypatch, "-m", model, "-c", "contrast", "-s", "1", "-o", str(tmp_path / model)) in (0, None)
        assert f"{label} (knowledge), 1 pair" in capsys.readouterr().out
        assert rf.load_run(tmp_path / model).name == listed[model] == label
        assert run_content(rf.load_run(tmp_path / model)).title == f"{label} on the demo"


def test_a_users_model_keeps_its_own_name(tmp_path):
    still = Still()
    still.name = "dis"
    assert rf.evaluate(still, output=tmp_path / "run", **SETTINGS).name == "dis"


def test_training_sets_are_an_option(tmp_path, monkeypatch, capsys):
    model = "robustflow.testing:ZeroFlow"
    options = ["-m", model, "-c", "contrast", "-s", "1", "--no-examples", "-o", str(tmp_path / "r")]
    assert run(monkeypatch, *options, "--trained-on", "C+T") in (0, None)
    provenance = rf.load_run(tmp_path / "r").manifest.provenance
    assert provenance.trained_on == ("flyingchairs", "flyingthings3d")
    assert run(monkeypatch, *options, "--trained-on", "C+T", "-O", "trained_on=C") == 2
    assert "give it once" in capsys.readouterr().err


@pytest.mark.parametrize("model", ["dis", "farneback", "dis_rgb"])
@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--device", "cuda", "runs on the CPU only; omit --device"),
        ("--precision", "bf16", "does not have a selectable precision; omit --precision"),
        ("--checkpoint", "things", "has no weights to load; omit --checkpoint"),
    ],
)
def test_what_a_model_without_a_network_does_not_take(monkeypatch, capsys, model, option, value, says):
    assert run(monkeypatch, "-m", model, option, value) == 2
    assert capsys.readouterr().err == f"robustflow: model '{model}' {says}\n"


def test_debug_shows_the_models_own_traceback(tmp_path, monkeypatch, capsys):
    (tmp_path / "model_that_fails.py").write_text("def fails(a, b):\n    return a.no_such_thing\n")
    monkeypatch.syspath_prepend(tmp_path)
    options = ["-m", "model_that_fails:fails", "-c", "contrast", "-o", str(tmp_path / "r")]
    assert run(monkeypatch, *options) == 1
    said = capsys.readouterr().err
    assert "no_such_thing" in said
    assert "model_that_fails.py:2)" in said
    assert "Traceback" not in said
    assert run(monkeypatch, *options, "--debug") == 1
    assert "Traceback" in (said := capsys.readouterr().err)
    assert "return a.no_such_thing" in said

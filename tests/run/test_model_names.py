"""The names of models are shown everywhere and do not affect any results."""

import pytest

import robustflow as rf
from robustflow.models.catalog import methods
from robustflow.report.site.content import run_content
from robustflow.run.records.pack import pack
from robustflow.testing import ZeroFlow

pytestmark = pytest.mark.usefixtures("demo_is_small")

SETTINGS = {"corruptions": ["contrast"], "severities": [1]}


class Still(ZeroFlow):
    name = "My model"


def test_name_comes_from_the_attribute_or_the_argument(tmp_path, real_pictures):
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


def test_name_option_sets_the_name_of_a_run(tmp_path, robustflow):
    options = ["run", "-m", "dis", "-c", "contrast", "-s", "1", "--no-examples", "-o", tmp_path / "run"]
    assert "DIS, ours" in robustflow.prints(*options, "--name", "DIS, ours")
    robustflow.prints(*options)
    assert rf.load_run(tmp_path / "run").name == "DIS, ours", "the name is kept by a later call without one"


def test_model_has_one_label_everywhere(tmp_path, robustflow):
    """A method has the same label in `list models` and in the tables of runs; no two methods share a label."""
    labels = [entry.method for entry in methods().values()]
    assert len(set(labels)) == len(labels)
    listed = dict(line.split()[:2] for line in robustflow.prints("list", "models").splitlines()[1:6])
    assert [listed[name] for name in ("dis", "farneback")] == ["DIS", "Farneback"]
    options = ["-c", "contrast", "-s", "1", "--no-examples", "-o", tmp_path / "run"]
    assert "DIS-RGB (knowledge) on 1 pair of the demo" in robustflow.prints("run", "-m", "dis_rgb", *options)
    assert rf.load_run(tmp_path / "run").name == listed["dis_rgb"] == "DIS-RGB"
    assert run_content(rf.load_run(tmp_path / "run")).title == "DIS-RGB on the demo"


def test_a_users_model_keeps_its_own_name(tmp_path):
    still = Still()
    still.name = "dis"
    assert rf.evaluate(still, output=tmp_path / "run", **SETTINGS).name == "dis"


def test_training_sets_are_stated_by_an_option(tmp_path, robustflow):
    model = "robustflow.testing:ZeroFlow"
    options = ["run", "-m", model, "-c", "contrast", "-s", "1", "--no-examples", "-o", tmp_path / "r"]
    robustflow.prints(*options, "--trained-on", "C+T")
    provenance = rf.load_run(tmp_path / "r").manifest.provenance
    assert provenance.trained_on == ("flyingchairs", "flyingthings3d")
    refused = robustflow.refuses(*options, "--trained-on", "C+T", "-O", "trained_on=C")
    assert refused.startswith("robustflow: --trained-on: ")


def test_debug_shows_the_models_own_traceback(tmp_path, monkeypatch, robustflow):
    (tmp_path / "model_that_fails.py").write_text("def fails(a, b):\n    return a.no_such_thing\n")
    monkeypatch.syspath_prepend(tmp_path)
    options = ["run", "-m", "model_that_fails:fails", "-c", "contrast", "-o", tmp_path / "r"]
    error = robustflow.refuses(*options, code=1)
    assert "no_such_thing" in error
    assert "model_that_fails.py:2)" in error
    code, _, error = robustflow(*options, "--debug")
    assert code == 1
    assert "Traceback" in error
    assert "return a.no_such_thing" in error

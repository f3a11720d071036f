"""Test the top level of the package: tab completion, printing, and progress, shown only where a user sees it."""

import os
import pty
import subprocess
import sys

import pytest
import skimage

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.models import ModelRef
from robustflow.run.manifest import Cells
from tests.made_rows import change_identity
from tests.refusals import refusal


@pytest.fixture(autouse=True, scope="module")
def _small(small_demo):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(skimage, "__file__", small_demo)
        yield


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("api") / "run"
    return rf.evaluate("dis", output=folder, corruptions=["contrast", "fog"], severities=[1, 3])


def test_completion_shows_the_public_names():
    """Modules loaded in a new interpreter before any public name is used."""
    shown = subprocess.run(
        [sys.executable, "-c", "import robustflow; print(*dir(robustflow))"], capture_output=True, text=True, check=True
    ).stdout.split()
    assert set(rf.__all__) <= set(shown)
    assert {"evaluate", "load_run", "compare"} <= set(shown)
    assert not {"annotations", "import_module", "TYPE_CHECKING"} & set(shown)


def test_printed_result_shows_the_means(result):
    text = str(result)
    head, means, over, where = text.splitlines()
    assert head.startswith("DIS (knowledge) on ")
    assert head.endswith(", 1 pair")
    numbers = ("epe_clean", "epe", "cre", "crer", "rcre")
    assert [part.split()[-2 if "px" in part else -1] for part in means.split(", ")] == [
        f"{getattr(result, name):.4g}" for name in numbers
    ]
    assert over == "mean over contrast, fog"
    assert where == str(result.path)


def test_printed_result_shows_control_characters_as_text(result):
    other = rf.load_run(result.path)
    change_identity(other, {"name": "a\x1b[31m\nb"})
    assert "\x1b" not in str(other)
    assert len(str(other).splitlines()) == 4


@pytest.mark.parametrize(
    ("progress", "screen", "seen"), [(None, True, True), (False, True, False), (None, False, False)]
)
def test_terminal_shows_progress_by_default(progress, screen, seen, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    ours, theirs = pty.openpty()
    with open(theirs, "w") as terminal, monkeypatch.context() as patch:
        if screen:
            patch.setattr(sys, "stderr", terminal)
        rf.evaluate("dis", output=tmp_path / "run", corruptions=["contrast"], severities=[1], progress=progress)
    os.set_blocking(ours, False)
    try:
        drawn = os.read(ours, 1 << 20)
    except OSError:  # nothing was written
        drawn = b""
    os.close(ours)
    assert capsys.readouterr() == ("", "")
    assert (b"2/2" in drawn) == seen
    assert bool(drawn) == seen


def test_a_named_model_is_loaded_once(tmp_path, monkeypatch):
    loaded = []
    load = ModelRef.load
    monkeypatch.setattr(ModelRef, "load", lambda self: loaded.append(self.name) or load(self))
    rf.evaluate("dis", output=tmp_path / "run", corruptions=["contrast"], severities=[1], examples=True)
    assert loaded == ["dis"]


def test_compare_takes_runs_folders_and_nothing_else(result):
    expected = rf.compare(result, result).frame
    assert rf.compare(result.path, str(result.path)).frame.equals(expected)
    assert result.compare(result.path).frame.equals(expected)
    refusal(lambda: rf.compare(result, result.rows), UsageError, "DataFrame")


def test_one_corruption_and_one_severity_need_no_list(tmp_path):
    run = rf.evaluate("dis", output=tmp_path / "run", corruptions="contrast", severities=3)
    assert run.manifest.planned == (Cells(samples=("motorcycle",), corruptions={"contrast": (3,)}),)
    refusal(lambda: rf.evaluate("dis", None, tmp_path), UsageError, "benchmark")
    refusal(lambda: rf.evaluate("dis", output=tmp_path / "run", corruptions="contrast", severities="3"), UsageError, 3)

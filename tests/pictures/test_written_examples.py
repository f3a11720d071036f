"""Example images of a run have the right contents and the same bytes every time, and are never partially written."""

from __future__ import annotations

import io
import json
import multiprocessing
import re
import shutil
import sys
import warnings

import numpy as np
import pytest
import skimage
from PIL import Image
from skimage import data

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.corruptions.digital import Contrast
from robustflow.media.images import write_image
from robustflow.models import ModelRef
from robustflow.pictures import examples as examples_module
from robustflow.report.gallery.examples import are_current
from robustflow.run.progress import DRAWN, TerminalProgress
from robustflow.run.repeat import recheck, restore_plan
from robustflow.run.source import RunSource
from robustflow.run.store import RunFolder
from robustflow.testing import ZeroFlow
from tests.made_rows import change_identity
from tests.refusals import refusal

DIS = ModelRef.parse("dis", {"preset": "ultrafast"})
CELLS = {"corruptions": ["contrast", "over_exposure"], "severities": [2, 5]}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, real_pictures):
    with real_pictures():
        return rf.evaluate(DIS, output=tmp_path_factory.mktemp("examples") / "run", examples=True, **CELLS)


@pytest.fixture
def small(monkeypatch, small_demo):
    monkeypatch.setattr(skimage, "__file__", small_demo)


def _files(run) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (run.path / "examples").iterdir()}


def test_index_of_examples_names_the_existing_files(drawn):
    record = json.loads((drawn.path / "examples" / "examples.json").read_text())
    assert record["version"] == 1
    pictures = [picture["file"] for picture in (*record["slider"]["pictures"], *record["panels"])]
    assert {*pictures, record["slider"]["clean"], "examples.json"} == set(_files(drawn))
    assert are_current(drawn)
    settings = [(picture["corruption"], picture["severity"]) for picture in record["slider"]["pictures"]]
    assert settings == [("contrast", 2), ("contrast", 5), ("over_exposure", 2), ("over_exposure", 5)]
    worst, median = record["panels"]
    assert (worst["kind"], median["kind"]) == ("worst", "median")
    cre = {
        (name, severity): drawn.mean("cre", name, severity)
        for name in CELLS["corruptions"]
        for severity in CELLS["severities"]
    }
    assert worst["cre"] == pytest.approx(max(cre.values()), abs=1e-12)
    assert median["cre"] == pytest.approx(sorted(cre.values())[1], abs=1e-12)
    assert worst["rcre"] >= abs(worst["cre"]) - 1e-12


@pytest.mark.parametrize(("name", "severity", "changed"), [("contrast", 5, 0), ("over_exposure", 2, 1)])
def test_slider_pictures_are_the_first_frames_that_the_corruption_changed(drawn, name, severity, changed):
    sample = rf.load_dataset("motorcycle").load("motorcycle")
    corrupted = rf.corrupt(*sample.frames, name, severity, key=sample.key)
    with Image.open(drawn.path / "examples" / f"{name}_{severity}.jpg") as picture:
        assert (picture.format, picture.size) == ("JPEG", (384, 259))
        small = [Image.fromarray(frame).resize(picture.size, Image.Resampling.BOX) for frame in corrupted]
        distances = [np.abs(np.asarray(picture, float) - np.asarray(frame)).mean() for frame in small]
    assert np.argmin(distances) == changed
    assert distances[changed] < 6, "what JPEG loses in a noisy frame"


def test_examples_are_the_same_with_every_engine(drawn, tmp_path, real_pictures):
    with real_pictures():
        again = rf.evaluate(DIS, output=tmp_path / "run", examples=True, workers=2, **CELLS)
    assert _files(again) == _files(drawn)


def test_a_run_of_one_sample_corrupts_each_frame_once(tmp_path, monkeypatch, small):
    applied = []
    apply = Contrast.apply
    monkeypatch.setattr(Contrast, "apply", lambda self, *args: applied.append(args[1:]) or apply(self, *args))
    asked = {"output": tmp_path / "run", "corruptions": ["contrast"], "severities": [1, 2, 3, 4, 5], "examples": True}
    run = rf.evaluate(ZeroFlow(), **asked)
    again = 2 * 2  # the worst and the median cell, compared in full
    assert len(applied) == 5 * 2 + again

    files = _files(run)
    shutil.rmtree(run.path / "examples")
    assert _files(rf.evaluate(ZeroFlow(), **asked)) == files, (
        "images from frames in memory equal those from recomputed ones"
    )


def test_pictures_of_a_run_of_one_sample_use_its_clean_flow(tmp_path, small):
    class Counting(ZeroFlow):
        predictions = 0

        def predict(self, frame1, frame2):
            self.predictions += 1
            return super().predict(frame1, frame2)

    model = Counting()
    run = rf.evaluate(model, output=tmp_path / "run", examples=True, **CELLS)
    again = 3
    assert model.predictions == len(run.rows) + again, "the first clean pair, the worst and the median cell"


def test_numbers_are_shown_before_anything_is_drawn(tmp_path, monkeypatch, small):
    folder, events = tmp_path / "run", []

    def show_numbers(result):
        drawn = [path.name for path in folder.iterdir() if path.name in ("examples", "report.html")]
        events.append((len(result.rows), drawn, (folder / "summary.json").exists()))

    progress = TerminalProgress(show_numbers)
    monkeypatch.setattr(progress, "drawing", lambda what="": events.append(what))
    rf.evaluate(ZeroFlow(), output=folder, examples=True, progress=progress, **CELLS)
    assert events == [(5, [], True), *DRAWN, ""]
    events.clear()
    rf.evaluate(ZeroFlow(), output=folder, examples=True, progress=progress, **CELLS)
    assert events == [(5, ["examples"], True), "page", ""]


def test_examples_are_drawn_once_and_deleted_when_the_rows_change(tmp_path, monkeypatch, small):
    run = {"output": tmp_path / "run", "severities": [2]}
    first = rf.evaluate(DIS, corruptions=["contrast"], examples=True, **run)
    before = _files(first)
    monkeypatch.setattr(examples_module, "_panel", lambda *_: pytest.fail("drawn again"))
    assert _files(rf.evaluate(DIS, corruptions=["contrast"], examples=True, **run)) == before
    more = rf.evaluate(DIS, corruptions=["contrast", "high_light"], **run)
    assert not (more.path / "examples").exists(), "images of outdated rows are deleted"
    assert not list(more.path.rglob(".partial-*"))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, MemoryError])
def test_interrupted_drawing_leaves_the_rows_and_no_partial_folder(tmp_path, monkeypatch, stop, small):
    def stopped(*_):
        raise stop

    monkeypatch.setattr(examples_module, "_write_slider", stopped)
    with pytest.raises(stop):
        rf.evaluate(ZeroFlow(), output=tmp_path / "run", examples=True, corruptions=["contrast"], severities=[2])
    assert not (tmp_path / "run" / "examples").exists()
    assert not list((tmp_path / "run").rglob(".partial-*"))
    assert rf.Result(tmp_path / "run").measured.complete
    assert (tmp_path / "run" / "summary.json").exists()


def test_ctrl_c_while_a_child_draws_leaves_no_child_and_no_partial_folder(tmp_path, monkeypatch, small):
    progress = TerminalProgress()
    monkeypatch.setattr(progress, "drawing", lambda what="": what != DRAWN[0] or _raise(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        rf.evaluate(DIS, output=tmp_path / "run", examples=True, workers=2, progress=progress, **CELLS)
    assert not multiprocessing.active_children()
    assert not list((tmp_path / "run").rglob(".partial-*"))


def _raise(error):
    raise error


def test_examples_of_a_model_that_predicts_differently_are_refused(tmp_path, small):
    class Drifts:
        """Predicts a larger motion with every call."""

        calls = 0

        def predict(self, frame1, frame2):
            self.calls += 1
            return np.full((*frame1.shape[:2], 2), self.calls, np.float32)

    with pytest.warns(UserWarning, match="'motorcycle', contrast severity 1"):
        run = rf.evaluate(Drifts(), output=tmp_path / "run", examples=True, corruptions=["contrast"], severities=[1])
    assert not (run.path / "examples").exists()
    assert run.measured.complete


def test_run_without_a_valid_source_cannot_be_set_up_again(tmp_path, small):
    run = rf.evaluate(ZeroFlow(), output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    refusal(lambda: restore_plan(run, RunSource.read(run.path)), RunError, run.path)
    assert "model" in str(refusal(lambda: restore_plan(run, RunSource(DIS)), RunError, run.path))
    (run.path / "source.json").write_text("{")
    refusal(lambda: RunSource.read(run.path), RunError, run.path / "source.json")


HOSTILE = {
    "marker_module:touch": {"name": "marker_module:touch", "options": {}},
    "onnx": {"name": "onnx", "options": {"checkpoint": "/tmp/x.onnx"}},
    "./net.ts": {"name": "./net.ts", "options": {}},
    "precomputed": {"name": "precomputed", "options": {"folder": "/etc"}},
    "/tmp/w.pth": {"name": "raft", "options": {"checkpoint": "/tmp/w.pth"}},
    "w.pth": {"name": "raft", "options": {"checkpoint": "w.pth"}},
    "os:system": {"name": "dis", "options": {"preset": "os:system"}},
    "ptlflow:a.b": {"name": "ptlflow:a.b", "options": {}},
}
"""What is refused in each model of a `source.json`."""


@pytest.mark.parametrize("culprit", HOSTILE)
def test_a_run_folder_cannot_name_code_or_files(culprit, drawn, tmp_path, robustflow):
    """Nothing named in the `source.json` of a received folder is imported or opened unless the user names it too."""
    (tmp_path / "marker_module.py").write_text("import pathlib; pathlib.Path('ran').touch()\ndef touch(*_): pass\n")
    source = shutil.copytree(drawn.path, tmp_path / "run") / "source.json"
    source.write_text(json.dumps(json.loads(source.read_text()) | {"model": HOSTILE[culprit]}))
    robustflow.refusal("report run --examples", RunError, culprit)
    assert not (tmp_path / "ran").exists()
    assert "marker_module" not in sys.modules


def test_the_user_may_name_the_model_again():
    given = {"checkpoint": "things"}
    source = RunSource(ModelRef.parse("raft", (("checkpoint", "/elsewhere/w.pth"), ("iters", 8))))
    assert source.model_to_reuse(given) == ModelRef.parse("raft", (("iters", 8), ("checkpoint", "things")))
    assert RunSource(ModelRef.parse("ptlflow:raft")).model_to_reuse({}) == ModelRef.parse("ptlflow:raft")
    assert RunSource().model_to_reuse({}) is None


def test_benchmark_named_in_a_run_folder_is_not_imported(drawn):
    run = rf.load_run(drawn.path)
    change_identity(run, benchmark="marker_module:touch")
    refusal(lambda: restore_plan(run, RunSource.read(run.path)), RunError, "marker_module:touch")
    refusal(lambda: recheck(run.manifest.identity, run.rows), RunError, "marker_module:touch")


def test_an_incomplete_run_has_no_worst_sample(tmp_path):
    for name in ("one", "two"):
        frame = data.astronaut()[:96, :160].copy() if name == "one" else data.cat()[:96, :160].copy()
        (tmp_path / "frames" / name).mkdir(parents=True)
        for index in range(2):
            write_image(tmp_path / "frames" / name / f"{index}.png", np.roll(frame, index, axis=1))
    run = {"benchmark": "folder", "data": tmp_path / "frames", "output": tmp_path / "run", "severities": [1]}
    rf.evaluate("dis", corruptions=["contrast"], **run)
    folder = RunFolder(tmp_path / "run")
    folder.lock()
    folder.drop_samples(["one/0"])
    folder.unlock()
    with pytest.warns(UserWarning, match=re.escape(str(tmp_path / "run"))):
        rf.evaluate("dis", corruptions=["high_light"], examples=True, limit=1, **run)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole = rf.evaluate("dis", corruptions=["contrast", "high_light"], examples=True, **run)
    record = json.loads((whole.path / "examples" / "examples.json").read_text())
    assert [panel["epe"] for panel in record["panels"]] == [None, None]
    assert {panel["key"] for panel in record["panels"]} <= {"one/0", "two/0"}
    with Image.open(io.BytesIO(_files(whole)["clean.jpg"])) as picture:
        assert picture.size == (160, 96), "a small frame is not enlarged"

"""Test `displacement`: the embedded pair's histogram equals that of its disparity, and a run stores the histogram of
its frames."""

from pathlib import Path

import numpy as np
import polars as pl

import robustflow as rf
from robustflow.images.io import write_image
from robustflow.runs.displacement_file import read_displacement


def test_displacement_of_the_embedded_pair_is_its_disparity(robustflow):
    code, out, _ = robustflow("displacement", "demo", "-o", "out")
    assert code == 0
    assert out.split() == [f"out/displacement.{form}" for form in ("csv", "png", "svg", "pdf")]
    table = pl.read_csv("out/displacement.csv")
    sample = rf.load_dataset("motorcycle", None).load("motorcycle")
    amplitude = np.abs(sample.flow[..., 0][sample.valid])
    assert table["pixels"].sum() == sample.valid.sum()
    assert table.filter(table["low"] >= 40)["pixels"].sum() == (amplitude >= 40).sum()
    assert Path("out/displacement.png").read_bytes()[1:4] == b"PNG"


def test_a_run_keeps_that_of_its_own_frames(robustflow, tmp_path):
    run = rf.evaluate("farneback", output=tmp_path / "run", corruptions=["contrast"], severities=[1])
    code, out, _ = robustflow("displacement", "demo", "--model", "dis", "--into", run.path)
    assert (code, out.strip()) == (0, str(run.path / "displacement.json"))
    assert read_displacement(run).source == "dis"
    assert not Path("displacement").exists()
    (tmp_path / "data").mkdir()
    for index in range(2):
        write_image(tmp_path / "data" / f"{index}.png", np.zeros((32, 32, 3), np.uint8))
    code, _, said = robustflow("displacement", "folder", "--data", tmp_path / "data", "-m", "dis", "--into", run.path)
    assert code == 2
    assert "contains 1 pair from demo, but these options select 1 from folder" in said


def _stills(folder, grey):
    folder.mkdir()
    for index in range(3):
        write_image(folder / f"{index}.png", np.full((32, 32, 3), grey + 20 * index, np.uint8))
    return folder


def test_the_page_of_a_run_shows_it_at_once(robustflow, tmp_path, real_pictures):
    data = _stills(tmp_path / "data", 40)
    with real_pictures():
        run = rf.evaluate("farneback", "folder", data, tmp_path / "run", corruptions=["contrast"], severities=[1])
    assert "Flow magnitudes" not in (run.path / "report.html").read_text()
    assert robustflow("displacement", "folder", "--data", data, "-m", "dis", "--into", run.path)[0] == 0
    assert "our own frames, 2 pairs (dis)" in (run.path / "report.html").read_text()


def test_other_frames_of_the_same_names_are_refused(robustflow, tmp_path):
    data, other = _stills(tmp_path / "data", 40), _stills(tmp_path / "other", 60)
    run = rf.evaluate("farneback", "folder", data, tmp_path / "run", corruptions=["contrast"], severities=[1])
    code, _, said = robustflow("displacement", "folder", "--data", other, "-m", "dis", "--into", run.path)
    assert code == 1
    assert "sample '0': these are not the frames of the run" in said
    assert read_displacement(run) is None


def test_a_record_holds_none(robustflow, tmp_path):
    (tmp_path / "a.robustflow").write_bytes(b"PK")
    code, _, said = robustflow("displacement", "demo", "--into", tmp_path / "a.robustflow")
    assert code == 2
    assert "stored in a run folder" in said

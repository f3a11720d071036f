"""Test `reproduce displacement`: the embedded pair's histogram equals that of its disparity, and a run stores the
histogram of its frames."""

import shutil
from pathlib import Path

import numpy as np
import polars as pl

import robustflow as rf
from robustflow.core.errors import UsageError
from robustflow.media.images import write_image
from robustflow.run.costs import read_displacement


def test_displacement_of_the_embedded_pair_is_its_disparity(robustflow):
    out = robustflow.prints("reproduce", "displacement", "demo", "-o", "out")
    assert out.split() == [f"out/displacement.{form}" for form in ("csv", "png", "svg", "pdf")]
    table = pl.read_csv("out/displacement.csv")
    sample = rf.load_dataset("motorcycle", None).load("motorcycle")
    amplitude = np.abs(sample.flow[..., 0][sample.valid])
    assert table["pixels"].sum() == sample.valid.sum()
    assert table.filter(table["low"] >= 40)["pixels"].sum() == (amplitude >= 40).sum()
    assert Path("out/displacement.png").read_bytes()[1:4] == b"PNG"


def _stills(folder, grey):
    folder.mkdir()
    for index in range(3):
        write_image(folder / f"{index}.png", np.full((32, 32, 3), grey + 20 * index, np.uint8))
    return folder


def test_displacement_is_stored_in_a_run_of_the_same_frames_only(robustflow, runs, tmp_path):
    path = shutil.copytree(runs[1], "run")
    out = robustflow.prints("reproduce", "displacement", "demo", "--model", "dis", "--into", path)
    assert out == "run/displacement.json\n"
    assert read_displacement(rf.load_run(path)).source == "dis"
    assert not Path("displacement").exists()
    data = _stills(tmp_path / "data", 40)
    robustflow.refusal(f"reproduce displacement folder -d {data} -m dis --into run", UsageError, "run")


def test_displacement_of_different_frames_with_the_same_names_is_refused(robustflow, tmp_path):
    data, other = _stills(tmp_path / "data", 40), _stills(tmp_path / "other", 60)
    run = rf.evaluate("farneback", "folder", data, tmp_path / "run", corruptions=["contrast"], severities=[1])
    command = ("reproduce", "displacement", "folder", "--data", other, "-m", "dis", "--into", run.path)
    robustflow.refuses(*command, code=1)
    assert read_displacement(run) is None

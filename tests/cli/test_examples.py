"""`robustflow run` draws its example pictures, and `robustflow report` draws those of a finished run."""

import shutil
from pathlib import Path

import pytest
from PIL import Image

from robustflow.api import evaluate
from robustflow.media.images import read_image, write_image
from robustflow.models import ModelSpec

from .conftest import write_frames


def test_report_with_examples_draws_the_same_pictures_as_the_run(robustflow, real_pictures):
    with real_pictures():
        robustflow.prints("run", "-m", "dis", "-O", "preset=ultrafast", "-c", "contrast", "-s", "3", "-o", "run")
        before = {path.name: path.read_bytes() for path in Path("run/examples").iterdir()}
        shutil.rmtree("run/examples")
        assert robustflow.prints("report", "run", "--examples").strip() == "run/examples"
    assert {path.name: path.read_bytes() for path in Path("run/examples").iterdir()} == before


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Such a run without example pictures."""
    folder = tmp_path_factory.mktemp("measured") / "run"
    model = ModelSpec("dis", (("preset", "ultrafast"),))
    return evaluate(model, output=folder, corruptions=["contrast"], severities=[1, 3]).path


def test_examples_of_one_cell_are_drawn_after_a_run_without_examples(robustflow, measured, real_pictures):
    shutil.copytree(measured, "run")
    cell = ("--sample", "motorcycle", "-c", "contrast", "-s", 3)
    with real_pictures():
        assert robustflow.prints("report", "run", *cell, "-o", "cell.png").strip() == "cell.png"
    with Image.open("cell.png") as picture:
        assert (picture.format, picture.width) == ("PNG", 1400)
    assert not Path("run/examples").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("--sample", "motorcycle"), 2, "a single picture needs"),
        (("--sample", "motorcycle", "-c", "contrast", "-s", 5), 2, "not include severity 5 of contrast"),
        (("--sample", "motorcycle", "-c", "fog", "-s", 1), 2, "unknown corruption of this run 'fog'"),
        (("--sample", "car", "-c", "contrast", "-s", 1), 2, "unknown sample of this run 'car'"),
        (("--examples", "-o", "x.png"), 2, "--output has no effect with --examples"),
        (("--examples", "-t", "epe"), 2, "--table has no effect"),
        (("-m", "farneback"), 2, "--model has no effect without --examples"),
        (("--examples", "-m", "farneback"), 1, "it differs in: model"),
        (("--examples", "-O", "preset=fast"), 1, "it differs in: model"),
        (("--examples", "-m", "no_such_module:net"), 1, "can no longer be loaded: cannot import 'no_such_module'"),
    ],
)
def test_example_that_cannot_be_drawn_is_refused_in_one_line(robustflow, measured, arguments, code, says):
    assert says in robustflow.refuses("report", measured, *arguments, code=code)


def test_examples_from_moved_data_work_and_from_changed_data_are_refused(robustflow, tmp_path):
    write_frames(tmp_path / "frames")
    (tmp_path / "mine_for_examples.py").write_text(
        "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), a.mean() / 50, np.float32)\n"
    )
    model = ("-m", "mine_for_examples:flow")
    robustflow.prints("run", *model, "-d", "frames", "-c", "contrast", "-s", 1, "-o", "run", "--no-examples")
    Path("frames").rename("moved")
    draw = ("report", "run", "--examples", *model)
    assert "no such folder or video" in robustflow.refuses(*draw, code=1)
    robustflow.prints(*draw, "--data", "moved")
    shutil.rmtree("run/examples")
    write_image(Path("moved/000.png"), 255 - read_image(Path("moved/001.png")))
    assert "differ from those of the run" in robustflow.refuses(*draw, "--data", "moved", code=1)
    assert not Path("run/examples").exists()

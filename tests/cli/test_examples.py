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
    ("arguments", "code"),
    [
        (("--sample", "motorcycle", "-c", "contrast", "-s", 5), 2),
        (("--sample", "motorcycle", "-c", "fog", "-s", 1), 2),
        (("--sample", "car", "-c", "contrast", "-s", 1), 2),
        (("--examples", "-m", "farneback"), 1),
        (("--examples", "-O", "preset=fast"), 1),
        (("--examples", "-m", "no_such_module:net"), 1),
    ],
)
def test_an_example_of_another_cell_or_model_is_refused(robustflow, measured, arguments, code):
    robustflow.refuses("report", measured, *arguments, code=code)


def test_examples_from_moved_data_work_and_from_changed_data_are_refused(robustflow, tmp_path):
    write_frames(tmp_path / "frames")
    (tmp_path / "mine_for_examples.py").write_text(
        "import numpy as np\ndef flow(a, b): return np.full((*a.shape[:2], 2), a.mean() / 50, np.float32)\n"
    )
    model = ("-m", "mine_for_examples:flow")
    robustflow.prints("run", *model, "-d", "frames", "-c", "contrast", "-s", 1, "-o", "run", "--no-examples")
    Path("frames").rename("moved")
    draw = ("report", "run", "--examples", *model)
    robustflow.refuses(*draw, code=1)
    robustflow.prints(*draw, "--data", "moved")
    shutil.rmtree("run/examples")
    write_image(Path("moved/000.png"), 255 - read_image(Path("moved/001.png")))
    robustflow.refuses(*draw, "--data", "moved", code=1)
    assert not Path("run/examples").exists()

"""When examples come from an untrusted folder, only pixels reach the page, and only from files in that folder."""

from __future__ import annotations

import base64
import io
import json
import shutil

import numpy as np
import pytest
from PIL import Image

from robustflow.api import Result
from robustflow.core.errors import DataError
from robustflow.report.site.examples import run_examples


@pytest.fixture
def copied(small_run, tmp_path) -> Result:
    return Result(shutil.copytree(small_run.path, tmp_path / "run"))


def _pixels(uri: str) -> np.ndarray:
    head, _, body = uri.partition(",")
    assert head == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(body))))


def _rewritten(run: Result, change) -> None:
    path = run.path / "examples" / "examples.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def test_the_slider_shows_the_folders_pictures(copied):
    slider, panels = run_examples(copied)
    assert [name for name, _ in slider.corruptions] == ["Contrast", "Fog"]
    assert [shot.severity for shot in slider.corruptions[0][1]] == [1, 5]
    clean = _pixels(slider.clean[0])
    assert clean.shape == (slider.height, slider.width, 3)
    spread = [float(np.std(_pixels(shot.pictures[0]))) for shot in slider.corruptions[0][1]]
    assert spread[1] < spread[0] < float(np.std(clean))
    assert [panel.title.split(":")[0] for panel in panels] == ["Worst sample", "Median sample"]
    assert "CRE" in panels[0].numbers


def test_page_without_an_examples_folder_has_no_pictures(copied):
    shutil.rmtree(copied.path / "examples")
    assert run_examples(copied) is None


@pytest.mark.parametrize(
    "name", ["../summary.json", "/etc/hostname", "..", ".hidden.jpg", "a/b.jpg", "a\\b.jpg", "x\n.jpg", "", "é.jpg"]
)
def test_example_file_name_with_a_folder_or_odd_characters_is_refused(copied, name):
    _rewritten(copied, lambda record: record["slider"].update(clean=name))
    with pytest.raises(DataError, match=r"slider\.clean"):
        run_examples(copied)


def test_links_are_not_followed(copied, tmp_path):
    secret = tmp_path / "secret.png"
    Image.new("RGB", (8, 8)).save(secret)
    target = copied.path / "examples" / "clean.jpg"
    target.unlink()
    target.symlink_to(secret)
    with pytest.raises(DataError, match="is a symbolic link"):
        run_examples(copied)


@pytest.mark.parametrize(
    "change",
    [
        lambda record: record.update(version=2),
        lambda record: record.update(more=1),
        lambda record: record["panels"][0].update(kind="<b>"),
        lambda record: record["panels"][0].update(epe="1"),
        lambda record: record["slider"].update(pictures=record["slider"]["pictures"] * 100),
        lambda record: record["slider"]["pictures"][0].update(severity=9),
    ],
)
def test_examples_of_a_different_structure_are_refused(copied, change):
    _rewritten(copied, change)
    with pytest.raises(DataError, match=r"examples\.json"):
        run_examples(copied)


def test_example_that_is_not_an_image_is_refused(copied):
    (copied.path / "examples" / "clean.jpg").write_bytes(b"<svg onload=alert(1)>")
    with pytest.raises(DataError, match="not an image"):
        run_examples(copied)
    (copied.path / "examples" / "examples.json").write_bytes(b"{" * 10)
    with pytest.raises(DataError, match="delete the folder"):
        run_examples(copied)


def test_metadata_of_example_images_are_dropped(copied):
    """A comment in the header of a JPEG file does not reach the page."""
    path = copied.path / "examples" / "clean.jpg"
    image = Image.open(path)
    image.load()
    image.save(path, comment=b"<script>alert(1)</script>")
    assert b"<script>" in path.read_bytes()
    slider, _ = run_examples(copied)
    assert b"<script>" not in base64.b64decode(slider.clean[0].partition(",")[2])

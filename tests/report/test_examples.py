"""Example pictures come from an untrusted folder, and only pixels reach the page; the embedded pair is cached."""

from __future__ import annotations

import base64
import io
import json
import shutil

import numpy as np
import polars as pl
import pytest
from PIL import Image

from robustflow.api import Result
from robustflow.core.arguments import SEVERITIES
from robustflow.core.errors import DataError
from robustflow.core.files import CACHE_VARIABLE, sealed
from robustflow.corruptions.weather.frost import photograph
from robustflow.corruptions.weather.frost_photographs import FOLDER_VARIABLE
from robustflow.report.gallery.cells import pair_cells
from robustflow.report.site import examples as embedded
from robustflow.report.site.examples import MOST_RUNS, examples_of, run_examples
from robustflow.stats.lines import LineKey
from tests.refusals import refusal


@pytest.fixture
def copied(small_run, tmp_path) -> Result:
    return Result(shutil.copytree(small_run.path, tmp_path / "run"))


def _pixels(address: str) -> np.ndarray:
    head, _, body = address.partition(",")
    assert head == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(body))))


def _rewrite(run: Result, change) -> None:
    path = run.path / "examples" / "examples.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def test_the_slider_and_the_panels_show_the_folders_pictures(copied):
    slider, panels = run_examples(copied)
    assert [(name, [shot.severity for shot in shots]) for name, shots in slider.corruptions] == [
        ("Contrast", [1, 5]),
        ("Fog", [1, 5]),
    ]
    clean = _pixels(slider.clean[0])
    assert clean.shape == (slider.height, slider.width, 3)
    spread = [float(np.std(_pixels(shot.pictures[0]))) for shot in slider.corruptions[0][1]]
    assert spread[1] < spread[0] < float(np.std(clean))
    assert [panel.title.partition(" ")[0] for panel in panels] == ["Worst", "Median"]
    shutil.rmtree(copied.path / "examples")
    assert run_examples(copied) is None


def test_pictures_of_a_run_that_went_on_and_was_interrupted_are_not_shown(copied):
    worst = run_examples(copied)[1][0]
    copied.rows = copied.rows.with_columns(
        epe_sum=pl.when(corruption="contrast", severity=1).then(1e3 * pl.col("n_valid")).otherwise("epe_sum")
    )
    assert worst.severity != 1
    assert run_examples(copied) is None


def test_example_panels_are_drawn_for_at_most_twelve_runs(small_run):
    assert MOST_RUNS == 12
    lines = {LineKey("demo", "frames", "OOD", f"{number}"): small_run for number in range(MOST_RUNS + 1)}
    fewer = dict(list(lines.items())[:MOST_RUNS])
    assert list(examples_of(fewer).panels) == list(fewer)
    assert len(examples_of(lines).panels) == 1


def _renamed(name):
    return lambda record: record["slider"].update(clean=name)


@pytest.mark.parametrize(
    "change",
    [
        *map(_renamed, ("../summary.json", "/etc/hostname", "..", ".hidden.jpg", "a/b.jpg", "a\\b.jpg", "x\n.jpg", "")),
        lambda record: record.update(version=2),
        lambda record: record.update(more=1),
        lambda record: record["panels"][0].update(kind="<b>"),
        lambda record: record["panels"][0].update(epe="1"),
        lambda record: record["slider"].update(pictures=record["slider"]["pictures"] * 300),
        lambda record: record["slider"]["pictures"][0].update(severity=9),
    ],
)
def test_list_with_a_path_or_a_different_structure_is_refused(copied, change):
    _rewrite(copied, change)
    refusal(lambda: run_examples(copied), DataError, copied.path / "examples" / "examples.json")


def test_files_other_than_pictures_in_the_folder_are_refused(copied, tmp_path):
    picture, secret = copied.path / "examples" / "clean.jpg", tmp_path / "secret.png"
    picture.write_bytes(b"<svg onload=alert(1)>")
    refusal(lambda: run_examples(copied), DataError, picture)
    Image.new("RGB", (8, 8)).save(secret)
    picture.unlink()
    picture.symlink_to(secret)
    refusal(lambda: run_examples(copied), DataError, picture)
    (copied.path / "examples" / "examples.json").write_bytes(b"{" * 10)
    refusal(lambda: run_examples(copied), DataError, copied.path / "examples" / "examples.json")


def test_metadata_of_example_images_are_dropped(copied):
    path = copied.path / "examples" / "clean.jpg"
    image = Image.open(path)
    image.load()
    image.save(path, comment=b"<script>alert(1)</script>")
    assert b"<script>" in path.read_bytes()
    slider, _ = run_examples(copied)
    assert b"<script>" not in base64.b64decode(slider.clean[0].partition(",")[2])


@pytest.fixture
def drawn(tmp_path, monkeypatch, real_pictures):
    """Draw the embedded pair at one severity of two corruptions, with a separate cache; list what was drawn."""
    calls = []

    def few(sample, severities, **options):
        calls.append(severities)
        return pair_cells(sample, severities[:1], corruptions=["contrast", "frost"], **options)

    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(embedded, "pair_cells", few)
    with real_pictures():
        yield calls


def test_the_embedded_pair_needs_no_photographs_of_frost(drawn, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    photograph.cache_clear()
    assert [name for name, _ in embedded.embedded_slider().corruptions] == ["Contrast", "Frost"]
    assert drawn == [SEVERITIES]


DAMAGE = {
    "none": lambda text: text,
    "a picture replaced": lambda text: text.replace("data:image/jpeg", "data:image/png", 1),
    "of different frames": lambda text: json.dumps(sealed(json.loads(text) | {"source": "0" * 32})),
    "cut short": lambda text: text[: len(text) // 2],
    "a list": lambda text: "[]",
    "empty": lambda text: "",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_the_embedded_pair_is_drawn_again_only_if_its_file_changed(drawn, tmp_path, damage):
    first = embedded.embedded_slider()
    (cached,) = tmp_path.rglob("motorcycle.json")
    cached.write_text(DAMAGE[damage](cached.read_text()))
    assert [embedded.embedded_slider() for _ in range(2)] == [first, first]
    assert len(drawn) == (1 if damage == "none" else 2)

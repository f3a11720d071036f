"""A page of many runs has a limited number of pictures and curves, and draws the embedded pair once."""

import json

import pytest

from robustflow.core.arguments import SEVERITIES
from robustflow.core.files import CACHE_VARIABLE, sealed
from robustflow.corruptions.weather.frost import photograph
from robustflow.corruptions.weather.frost_photographs import FOLDER_VARIABLE
from robustflow.report.gallery.pictures import gallery
from robustflow.report.site import examples as embedded
from robustflow.report.site.content import whole_content
from robustflow.report.site.examples import MOST_RUNS, examples_of
from robustflow.report.site.figures import page_figures
from robustflow.stats.run_results import run_results


def test_example_panels_are_drawn_for_at_most_twelve_runs(small_run):
    assert MOST_RUNS == 12
    lines = [line for _ in range(MOST_RUNS + 1) for line in run_results([small_run])]
    assert list(examples_of(lines[:MOST_RUNS]).panels) == lines[:MOST_RUNS]
    assert list(examples_of(lines).panels) == lines[:1]


def test_curves_are_drawn_for_the_eight_runs_with_the_lowest_error(many_images):
    """Runs in order from worst to best, so that a page cannot rely on their order."""
    runs = [many_images("m" * index, 1 + 0.1 * index) for index in range(9, 0, -1)]
    (group,) = page_figures(whole_content(runs, published=False))
    (curves,) = (one for one in group.figures if one.title == "Severity curves")
    assert {name for name, _ in curves.lines} == {"m" * index for index in range(1, 9)}
    assert "The 8 of 9 runs with the lowest error are drawn." in curves.caption


@pytest.fixture(autouse=True)
def _real_pictures(real_pictures):
    with real_pictures():
        yield


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Draw the embedded pair at one severity of two corruptions, with a separate cache; list what was drawn."""
    calls = []

    def few(sample, severities, **options):
        calls.append(severities)
        return gallery(sample, severities[:1], corruptions=["contrast", "frost"], **options)

    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(embedded, "gallery", few)
    return calls


def test_the_embedded_pair_is_drawn_once(drawn):
    first = embedded.embedded_slider()
    assert embedded.embedded_slider() == first
    assert drawn == [SEVERITIES]


def test_the_embedded_pair_needs_no_photographs_of_frost(drawn, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    photograph.cache_clear()
    assert [name for name, _ in embedded.embedded_slider().corruptions] == ["Contrast", "Frost"]


def _with_markup(kept):
    kept["slider"]["clean"][0] = "data:image/svg+xml,<svg onload=alert(1)/>"
    return kept


DAMAGE = {
    "a picture replaced": lambda text: json.dumps(_with_markup(json.loads(text))),
    "no JPEG, with a matching digest": lambda text: json.dumps(sealed(_with_markup(json.loads(text)))),
    "of different frames, with a matching digest": lambda text: json.dumps(
        sealed(json.loads(text) | {"source": "0" * 32})
    ),
    "cut short": lambda text: text[: len(text) // 2],
    "a list": lambda text: "[]",
    "nested": lambda text: "[" * 200_000,
    "empty": lambda text: "",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_changed_file_of_the_embedded_pair_is_drawn_again(drawn, tmp_path, damage):
    first = embedded.embedded_slider()
    (cached,) = tmp_path.rglob("motorcycle.json")
    cached.write_text(DAMAGE[damage](cached.read_text()))
    assert embedded.embedded_slider() == first
    assert len(drawn) == 2
    assert embedded.embedded_slider() == first
    assert len(drawn) == 2

"""A figure inside a page: marks have labels, ids are unique, and colours are those of the page."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from robustflow.report.figures import clean_against_cre, relations, severity_curves
from robustflow.report.site.svg import inline_svg
from robustflow.stats.published.tables import published_results

from ...analysis.simulated import Truth, rows_of

_KITTI = [line for line in published_results() if line.benchmark == "kitti-fc"]


def _svg(figure, prefix="f1"):
    return ElementTree.fromstring(inline_svg(figure, prefix, lambda model: f"page-{model}"))


def _marks(root):
    return [element for element in root.iter() if element.get("class") == "mark"]


def test_every_model_is_a_mark_with_its_numbers():
    marks = _marks(_svg(clean_against_cre(_KITTI)))
    assert len(marks) == 11 + 14
    labels = {mark.get("data-label") for mark in marks}
    assert "RAFT (ID): clean EPE 1.81 px, CRE 6.70 px, CREr 3.70" in labels
    assert {mark.get("data-page") for mark in marks} >= {"page-RAFT", "page-ARFlow"}


def test_a_mark_is_where_its_model_is():
    """In one panel, marks are ordered by clean EPE from left to right."""
    figure = relations(_KITTI)
    root = _svg(figure)
    epe = {line.name: line.number("epe", "clean") for line in _KITTI if line.setting == "OOD"}
    first = root.find("svg")
    panel = [mark for mark in _marks(first) if "(OOD)" in mark.get("data-label")]
    by_place = sorted(panel, key=lambda mark: float(mark.get("x")))
    names = [mark.get("data-page").removeprefix("page-") for mark in by_place]
    assert names == sorted(names, key=epe.__getitem__)
    assert len(names) == 11


def test_ids_are_prefixed_and_colours_follow_the_page():
    text = inline_svg(clean_against_cre(_KITTI), "f7", lambda model: None)
    assert set(re.findall(r'\bid="(f7-)?', text)) == {"f7-"}
    assert not re.findall(r"#[0-9a-f]{6}", text)
    assert "xlink" not in text
    assert "<style" not in text
    assert "data-page" not in text
    assert 'role="img"' in text


def test_panels_do_not_overlap_and_have_one_size():
    """Panels are separate elements that do not overlap, so that a page can arrange them in rows."""
    figure = relations(_KITTI)
    panels = _svg(figure).findall("svg")
    boxes = [list(map(float, panel.get("viewBox").split())) for panel in panels]
    assert len(boxes) == len(figure.axes) == 4
    assert len({(width, height) for _, _, width, height in boxes}) == 1
    for index, (x, y, width, height) in enumerate(boxes):
        assert len([mark for mark in panels[index].iter("use") if mark.get("class") == "mark"]) == 11 + 14
        for mark in panels[index].iter("use"):
            if mark.get("class") == "mark":
                assert x <= float(mark.get("x")) <= x + width
                assert y <= float(mark.get("y")) <= y + height


def test_points_of_one_line_have_distinct_labels():
    rows = rows_of(*(Truth().draw(np.random.default_rng(0), np.ones(3, int))[i] for i in (0, 1, 1)))
    root = _svg(severity_curves({"a": rows}))
    labels = [mark.get("data-label") for mark in _marks(root)]
    assert len(labels) == len(set(labels)) == 3
    assert [re.search("severity ([0-9])", text)[1] for text in labels] == ["1", "3", "2"]

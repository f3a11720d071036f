"""The gallery page, opened from disk in a real browser."""

from __future__ import annotations

from pathlib import Path

import pytest
from skimage import data

from robustflow.report.gallery.page import render_page
from robustflow.report.gallery.pictures import gallery

pytestmark = pytest.mark.browser


def test_slider_changes_the_picture_and_nothing_is_fetched(visit, tmp_path: Path) -> None:
    frame = data.astronaut()[:96, :160].copy()
    page_file = tmp_path / "gallery.html"
    page_file.write_text(render_page(frame, list(gallery(frame, frame, [1, 5], ["contrast"])), 1, "<b>title</b>"))
    seen = visit()
    seen.page.goto(page_file.as_uri())
    shown = seen.page.locator("figure img:visible").last
    mild = shown.get_attribute("src")
    seen.page.locator("input[type=range]").focus()
    seen.page.keyboard.press("End")
    assert seen.page.locator("figure img:visible").last.get_attribute("src") != mild
    assert "<b>title</b>" in seen.page.inner_text("body")
    assert seen.outside() == []
    assert seen.complaints == []

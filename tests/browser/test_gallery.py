"""Test the gallery page, opened from disk in a real browser."""

from __future__ import annotations

from pathlib import Path

import pytest
from skimage import data

from robustflow.media.images import write_image
from robustflow.report.gallery.cells import ClipPart, clip_cells
from robustflow.report.gallery.slider import gallery_files

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def clip_page(tmp_path_factory) -> Path:
    """The gallery of a folder of eight frames."""
    folder = tmp_path_factory.mktemp("clip")
    for index in range(8):
        write_image(folder / f"{index}.png", data.astronaut()[:96, 4 * index : 4 * index + 160].copy())
    part = ClipPart(folder, shown=5)
    shown = list(part.frames(part.shown))
    encoded = tmp_path_factory.mktemp("encoded")
    cells = clip_cells(part, shown, [1, 5], ["snow", "spatter", "h264_crf"], encoded)
    files = gallery_files("<b>Eight</b> frames", shown, cells, 5, part.first_number, ["a remark"])
    page_file = folder / "gallery.html"
    page_file.write_bytes(files["gallery.html"])
    return page_file


def test_a_clip_plays_and_steps_by_keyboard(visit, clip_page):
    seen = visit()
    page = seen.page
    page.goto(clip_page.as_uri())
    assert page.locator(".slider figure:visible").count() == 4
    assert "<b>Eight</b>" in page.inner_text("body")
    snow = page.get_by_alt_text("Snow at severity 5")
    frame, first = page.locator("#slider-frame"), snow.get_attribute("src")
    frame.focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#slider-frame-shown").inner_text() == "2"
    assert snow.get_attribute("src") != first
    assert snow.get_attribute("alt") == "Snow at severity 5, frame 2"
    page.keyboard.press("Home")
    assert snow.get_attribute("src") == first
    play = page.locator("#slider-play")
    play.focus()
    page.keyboard.press("Space")
    assert play.inner_text() == "Pause"
    seen_frames = set()
    for _ in range(200):  # wait_for_function evaluates strings, which the page's policy forbids
        seen_frames.add(frame.input_value())
        if len(seen_frames) >= 3:
            break
        page.wait_for_timeout(50)
    assert len(seen_frames) >= 3
    page.keyboard.press("Space")
    assert play.inner_text() == "Play"
    stopped = frame.input_value()
    page.wait_for_timeout(500)
    assert frame.input_value() == stopped
    page.locator("#slider-corruption").select_option(label="H.264 CRF")
    assert page.locator(".slider figure:visible").count() == 2
    assert page.locator(".slider [data-corruption]:visible img").evaluate("image => image.naturalWidth") == 160
    assert seen.outside() == []
    assert seen.complaints == []


def test_gallery_has_no_serious_accessibility_violation(visit, serious_violations, clip_page):
    page = visit().page
    page.goto(clip_page.as_uri())
    for scheme, width in (("light", 1440), ("dark", 1440), ("dark", 390), ("light", 390)):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        assert serious_violations(page, colours_alone=scheme == "dark") == [], (scheme, width)
        assert page.evaluate("document.documentElement.scrollWidth") <= width

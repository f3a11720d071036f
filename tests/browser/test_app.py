"""Test the app's page in a real browser: the demo pair, uploads, keyboard, clicks, and accessibility."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
import skimage
from PIL import Image

import robustflow as rf
from robustflow.app.serve import _redirect

from ..app.launch import SCRIPTED, App, running_app, with_demo
from ..app.library import direct_numbers, png

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.browser
pytest.importorskip("starlette", reason="the app extra is not installed")
api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (dev extra)")
expect = api.expect
expect.set_options(timeout=60_000)  # only a safeguard against hanging


@pytest.fixture(scope="module")
def app(browser, small_demo, tmp_path_factory) -> Iterator[App]:
    """The running app, with the small demo pair; skips without starting it if there is no browser."""
    with running_app(tmp_path_factory.mktemp("app"), start=with_demo(small_demo)) as running:
        yield running


@pytest.fixture(scope="module")
def scripted(browser, small_demo, tmp_path_factory) -> Iterator[App]:
    """The running app, with the small demo pair and a scripted model first."""
    with running_app(tmp_path_factory.mktemp("app"), "--model", SCRIPTED, start=with_demo(small_demo)) as running:
        yield running


@pytest.fixture
def opened(visit, app):
    """Open the page and wait for its first result: `opened(width=390)`."""

    def go(**options):
        seen = visit(**options)
        seen.page.goto(app.address)
        expect(seen.page.locator("#status")).to_contain_text("dis, fog 3")
        return seen

    return go


def _number(page: Page, name: str) -> float:
    return float(page.locator(f"#number-{name}").get_attribute("value") or "nan")


def _set_severity(page: Page, key: str, layer: int = 0) -> None:
    page.get_by_label("Severity", exact=True).nth(layer).focus()
    page.keyboard.press(key)


def _file(name: str, data: bytes) -> dict[str, object]:
    return {"name": name, "mimeType": "application/octet-stream", "buffer": data}


def _clean(seen, app: App) -> None:
    assert seen.complaints == []
    assert seen.outside(f"http://{app.host}/") == []


def test_the_demo_pair_under_fog_has_the_librarys_numbers(opened, app, small_demo, monkeypatch):
    seen = opened()
    page = seen.page
    assert page.url == f"http://{app.host}/", "the token is removed from the address"
    page.get_by_label("Corruption", exact=True).select_option("snow")
    expect(page.locator("#status")).to_contain_text("snow 3")
    page.get_by_label("Corruption", exact=True).select_option("fog")
    _set_severity(page, "End")
    expect(page.locator("#status")).to_contain_text("fog 5")
    worst = _number(page, "epe")
    _set_severity(page, "ArrowLeft")
    _set_severity(page, "ArrowLeft")
    expect(page.locator("#status")).to_contain_text("fog 3")
    monkeypatch.setattr(skimage, "__file__", small_demo)
    sample = rf.load_dataset("motorcycle").load("motorcycle")
    numbers = direct_numbers(sample.frames, (sample.flow, sample.valid), "fog", 3, 0, sample.key)
    assert {name: _number(page, name) for name in numbers} == pytest.approx(numbers)
    assert worst > numbers["epe"]
    expect(page.locator("#pictures img:visible")).to_have_count(8)
    _clean(seen, app)


def test_the_file_that_the_browser_opens_leads_to_the_page_and_no_other_port_gets_its_token(visit, app, tmp_path):
    seen = visit()
    page = seen.page
    page.goto(_redirect(tmp_path, app.address).as_uri())
    expect(page.locator("#status")).to_contain_text("dis, fog 3")
    assert page.url == f"http://{app.host}/"
    page.reload()
    expect(page.locator("#status")).to_contain_text("dis, fog 3")
    assert page.context.cookies() == []
    _clean(seen, app)
    page.evaluate("sessionStorage.clear()")
    page.reload()
    expect(page.locator("#error")).to_contain_text("token")


def test_only_the_last_of_many_quick_changes_is_shown(opened, app):
    seen = opened()
    page = seen.page
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.post_data or "") if "/preview" in request.url else None)
    _set_severity(page, "Home")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#status")).to_contain_text("dis, fog 5")
    assert len(asked) < 4, "key presses in quick succession cause a single request"
    _clean(seen, app)


def test_a_slow_answer_does_not_come_after_a_newer_one(visit, scripted):
    seen = visit()
    page = seen.page
    with scripted.model_does("wait"):
        page.goto(scripted.address)
        expect(page.locator("#status")).to_contain_text("Predicting")
        with page.expect_request("**/preview"):
            page.locator("#model").select_option("farneback")
    # One prediction runs at a time: this one ends after the slow one.
    expect(page.locator("#status")).to_contain_text("farneback, fog 3: predicted")
    expect(page.locator("#busy")).to_be_hidden()
    _clean(seen, scripted)


def test_nothing_of_the_old_model_stays_when_the_new_one_fails(visit, scripted):
    page = visit().page
    with scripted.model_does("fail"):
        page.goto(scripted.address)
        expect(page.locator("#error")).to_be_visible()
        expect(page.locator("#pictures figure")).to_have_count(0)
        page.locator("#model").select_option("farneback")
        expect(page.locator("#status")).to_contain_text("farneback, fog 3: predicted")
        expect(page.locator("#checkpoint-field")).to_be_hidden()
        page.locator("#model").select_option(SCRIPTED)
        expect(page.locator("#status")).to_contain_text("No result")
        expect(page.locator("#pictures figure")).to_have_count(0)
        expect(page.locator("#numbers")).to_be_empty()


def test_two_models_are_shown_side_by_side_and_saved(opened, app, tmp_path):
    """The second model's numbers do not depend on the first, and the saved image has the height of its contents."""
    seen = opened()
    page = seen.page
    alone = _number(page, "epe")
    page.locator("#second").select_option("farneback")
    expect(page.locator("#status")).to_contain_text("dis and farneback, fog 3: predicted")
    assert _number(page, "epe") == alone
    second = _number(page, "epe-second")
    expect(page.locator("#pictures img:visible")).to_have_count(11)
    captions = page.locator("#pictures figcaption").all_inner_texts()
    for whose in ("dis", "farneback"):
        assert f"Flow on the corrupted frames, {whose}" in captions
    with page.expect_download() as download:
        page.get_by_role("button", name="Save this view").click()
    download.value.save_as(tmp_path / "saved.png")
    with Image.open(tmp_path / "saved.png") as saved:
        assert saved.width == 3 * 652 + 12
        assert len(saved.convert("RGB").getcolors(2**24) or ()) > 1000
    page.get_by_role("button", name="Measure all five severities").click()
    expect(page.locator("#sweep-rows tr")).to_have_count(10)
    page.locator("#second").select_option("")
    expect(page.locator("#status")).to_contain_text("dis, fog 3: predicted")
    expect(page.locator("#pictures img:visible")).to_have_count(8)
    expect(page.locator("#number-epe-second")).to_have_count(0)
    page.locator("#model").select_option("farneback")
    expect(page.locator("#status")).to_contain_text("farneback, fog 3: predicted")
    assert _number(page, "epe") == second
    _clean(seen, app)


def test_stack_of_corruptions_is_shown_at_five_severities(opened, app):
    seen = opened()
    page = seen.page
    page.get_by_role("button", name="Measure all five severities").click()
    expect(page.locator("#sweep-rows tr")).to_have_count(5)
    expect(page.locator("#status")).to_contain_text("all five severities measured")
    shown = page.locator("#sweep-rows tr").nth(2).locator("td").first.inner_text()
    assert float(shown) == pytest.approx(_number(page, "epe"), abs=5.1e-4)
    page.get_by_role("button", name="Add another corruption").click()
    expect(page.locator("#status")).to_contain_text("fog 3 + jpeg compression 3")
    expect(page.locator("#call")).to_contain_text('"fog:3+jpeg_compression:3"')
    expect(page.get_by_role("button", name="Measure all five severities")).to_be_disabled()
    page.get_by_role("button", name="Remove corruption 2").click()
    expect(page.locator("#status")).to_contain_text(re.compile(r"fog 3: predicted"))
    _clean(seen, app)


def test_uploaded_frames_and_ground_truth_give_the_error(opened, app, tmp_path):
    seen = opened()
    page = seen.page
    rng = np.random.default_rng(1)
    frame = np.repeat(np.repeat(rng.integers(0, 255, (40, 60, 3)), 3, 0), 3, 1).astype(np.uint8)
    rf.write_flow(tmp_path / "gt.png", np.tile(np.array([2.0, 0.0]), (*frame.shape[:2], 1)))
    page.get_by_text("Your own frames: drop files, or choose them").click()
    page.get_by_label("Frame 1").set_input_files(_file("<img src=x onerror=alert(1)>.png", png(frame)))
    page.get_by_role("button", name="Use these frames").click()
    expect(page.get_by_role("alert")).to_have_text("choose both frames first")
    page.get_by_label("Frame 2").set_input_files(_file("b.png", png(np.roll(frame, 2, axis=1))))
    page.get_by_role("button", name="Use these frames").click()
    expect(page.locator("#shown")).to_have_text("img src=x onerror=alert(1).png, b.png")
    expect(page.locator("#pictures img:visible")).to_have_count(7)
    expect(page.locator("#number-epe")).to_have_count(0)
    page.get_by_label("Ground truth").set_input_files(tmp_path / "gt.png")
    page.get_by_role("button", name="Use these frames").click()
    expect(page.locator("#number-epe")).to_have_count(1)
    expect(page.locator("#pictures img:visible")).to_have_count(8)
    page.get_by_role("button", name="Use the demo pair").click()
    expect(page.locator("#shown")).to_contain_text("Motorcycle")
    expect(page.locator("#status")).to_contain_text("predicted")
    _clean(seen, app)


def test_text_file_named_as_an_image_is_refused_in_one_line(opened, app):
    seen = opened()
    page = seen.page
    page.get_by_text("Your own frames: drop files, or choose them").click()
    for field in ("Frame 1", "Frame 2"):
        page.get_by_label(field).set_input_files(_file("notes.png", b"<b>only</b> text\n"))
    page.get_by_role("button", name="Use these frames").click()
    expect(page.get_by_role("alert")).to_contain_text("notes.png: ")
    assert "\n" not in page.get_by_role("alert").inner_text()
    expect(page.locator("#shown")).to_have_text("No frames: choose different ones, or the demo pair.")
    expect(page.locator("#pictures figure")).to_have_count(0)
    expect(page.locator("#numbers")).to_be_empty()
    for field in ("#frame1", "#frame2"):
        assert page.locator(field).evaluate("input => input.files.length") == 0
    page.locator("#model").select_option("farneback")
    page.wait_for_timeout(600)  # longer than the delay before a request
    expect(page.locator("#pictures figure")).to_have_count(0)
    page.get_by_role("button", name="Use the demo pair").click()
    expect(page.locator("#status")).to_contain_text("farneback, fog 3: predicted")
    expect(page.get_by_role("alert")).to_be_hidden()
    refused = [line for line in seen.complaints if "400" not in line]
    assert refused == [], "the browser logs only the refused request"


def test_dropped_frames_are_in_natural_order(opened, app):
    seen = opened()
    page = seen.page
    frame = np.random.default_rng(2).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    carried = page.evaluate_handle(
        """(files) => {
            const carried = new DataTransfer();
            for (const [name, bytes] of files) carried.items.add(new File([new Uint8Array(bytes)], name));
            return carried;
        }""",
        [["10.png", list(png(frame))], ["9.png", list(png(frame))]],
    )
    page.dispatch_event("#results", "drop", {"dataTransfer": carried})
    expect(page.locator("#shown")).to_have_text("9.png, 10.png")
    expect(page.locator("#status")).to_contain_text("predicted")
    _clean(seen, app)


def test_narrow_app_does_not_scroll_sideways_and_works_by_keyboard(opened, app):
    seen = opened(width=390, height=844)
    page = seen.page
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.locator("body").click(position={"x": 2, "y": 2})
    names = []
    for _ in range(14):
        page.keyboard.press("Tab")
        names.append(page.evaluate("document.activeElement.id || document.activeElement.tagName"))
    assert {"theme", "model", "seed", "add", "sweep"} <= set(names)
    page.get_by_text("Your own frames: drop files, or choose them").click()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    _clean(seen, app)


def test_app_has_no_serious_accessibility_violation(opened, serious_violations):
    page = opened(bypass_csp=True).page  # axe injects a script into the page
    page.get_by_text("Your own frames: drop files, or choose them").click()
    page.get_by_role("button", name="Add another corruption").click()
    page.get_by_role("button", name="Remove corruption 2").click()
    page.get_by_role("button", name="Measure all five severities").click()
    expect(page.locator("#status")).to_contain_text("all five severities measured")
    assert serious_violations(page) == []
    page.emulate_media(color_scheme="dark")
    assert serious_violations(page, colours_alone=True) == []


def test_the_theme_can_be_chosen(opened, app):
    seen = opened(color_scheme="dark")
    body = "getComputedStyle(document.body).backgroundColor"
    dark = seen.page.evaluate(body)
    seen.page.get_by_role("button", name="Light").click()
    assert seen.page.evaluate(body) != dark
    seen.page.get_by_role("button", name="Dark").click()
    assert seen.page.evaluate(body) == dark

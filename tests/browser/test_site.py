"""Opened from disk in a real browser, the pages work with pointer and keyboard and make no network requests."""

from __future__ import annotations

import polars as pl
import pytest

from robustflow.stats.published.tables import published_frame

from .conftest import HOSTILE

pytestmark = pytest.mark.browser


@pytest.fixture
def opened(visit, pages):
    """Open a page and check, after the test, that it made no request and logged no error."""
    seen = []

    def go(name: str, state: str = "", **options):
        one = visit(**options)
        seen.append(one)
        one.page.goto(pages[name].as_uri() + state)
        return one.page

    yield go
    for one in seen:
        assert one.outside() == []
        assert one.complaints == []


def _column(page, heading: str) -> list[str]:
    """Visible cells in a column of the visible leaderboard, by group."""
    head = page.locator(".board:visible thead th")
    index = next(
        i for i in range(head.count()) if head.nth(i).is_visible() and head.nth(i).inner_text().startswith(heading)
    )
    rows = page.locator(".board:visible tbody tr[data-page]:visible")
    return rows.locator(f"> :nth-child({index + 1})").all_inner_texts()


def _kitti(page) -> None:
    page.get_by_role("radio", name="KITTI-FC").check(force=True)


def _shown(page) -> str:
    return page.locator(".count:visible").inner_text()


def test_sorting_is_numeric_with_missing_values_last(opened):
    page = opened("leaderboard")
    _kitti(page)
    parameters = page.get_by_role("button", name="Param.")
    for sign, order in ((1, "ascending"), (-1, "descending")):
        parameters.click()
        assert page.locator("th[aria-sort]:visible").get_attribute("aria-sort") == order
        shown = _column(page, "Param.")
        numbers = [float(text) for text in shown if text != "–"]
        assert numbers == sorted(numbers, key=lambda value: sign * value)
        assert len(numbers) == 25
        assert shown[25:] == ["–"] * 4
    page.get_by_role("button", name="Model").click()
    names = _column(page, "Model")
    assert names == sorted(names, key=str.lower)
    best = page.locator(".board:visible tr[data-setting=OOD]:has-text('SAMFlow-H') td:visible b").all_inner_texts()
    assert best == ["3.78", "8.39"]


def test_filters_and_search_are_kept_in_the_address(opened):
    page = opened("leaderboard")
    _kitti(page)
    assert _shown(page) == "29 of 29 rows"
    page.get_by_role("radio", name="ID", exact=True).check(force=True)
    assert _shown(page) == "15 of 29 rows"
    page.get_by_label("Search", exact=True).locator("visible=true").fill("samflow")
    assert sorted(_column(page, "Model")) == ["SAMFlow-B", "SAMFlow-H", "SAMFlow-T"]
    page.get_by_label("Columns").locator("visible=true").select_option("weather")
    page.locator("select[data-part=metric]").locator("visible=true").select_option("cre")
    page.get_by_role("button", name="Snow").click()
    snow = published_frame().filter(setting="ID", measure="cre", condition="snow").sort("value")
    expected = [f"{row['value']:.2f}" for row in snow.iter_rows(named=True) if row["model"].startswith("SAMFlow")]
    assert _column(page, "Snow") == expected
    address = page.url
    page.goto("about:blank")
    page.goto(address)
    assert _column(page, "Snow") == expected
    assert _shown(page) == "3 of 29 rows"
    assert page.locator("[role=status].count:visible").get_attribute("aria-live") == "polite"


def test_choosing_a_benchmark_filters_the_whole_page(opened):
    """The table, figures, pictures and audit exist, as do the links to them."""
    page = opened("leaderboard")
    for name, figures in (("demo", 1), ("KITTI-FC", 4), ("GoPro-FC", 0)):
        page.get_by_role("radio", name=name).check(force=True)
        assert page.locator("section.benchmark:visible h2").all_inner_texts() == [name]
        assert page.locator(".board:visible").count() == 1
        assert page.locator("figure.drawn:visible").count() >= figures
        assert bool(page.locator("figure.drawn:visible").count()) == bool(figures)
        assert page.locator("#examples").is_visible() == (name == "demo")
        links = page.locator("nav a:visible").evaluate_all("links => links.map(link => link.getAttribute('href'))")
        assert len(links) == len(set(links)) > 0
        assert all(page.locator(link).is_visible() for link in links)
    _kitti(page)
    page.locator(".audit input:visible").fill("brightflow")
    assert page.locator(".audit tbody tr:visible").count() > 5
    assert all("BrightFlow" in text for text in page.locator(".audit tbody tr:visible").all_inner_texts())


_BROKEN = """cells => cells.filter((cell) => cell.textContent.split(" ").some((word) => {
    const one = document.createElement("span");
    one.style.whiteSpace = "nowrap";
    one.textContent = word;
    cell.append(one);
    const wide = one.offsetWidth;
    one.remove();
    const style = getComputedStyle(cell);
    return wide > cell.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight) + 1;
})).map((cell) => cell.textContent)"""


def test_a_phone_shows_model_epe_and_cre_and_scrolls_only_inside_the_table(opened):
    page = opened("leaderboard", width=390, height=844)
    assert _column(page, "Model")[1].split() == ["Twin", "group", "a", "knowledge"]
    _kitti(page)
    head = page.locator(".board:visible thead th:visible")
    assert [text.split()[0] for text in head.all_inner_texts()] == ["Model", "EPE", "CRE"]
    box = page.locator(".board:visible .scroll").bounding_box()
    for index in range(3):
        cell = head.nth(index).bounding_box()
        assert cell["x"] >= box["x"]
        assert cell["x"] + cell["width"] <= box["x"] + box["width"] + 1
    assert page.locator("th[aria-sort]:visible").inner_text().startswith("EPE")
    assert page.locator(".board:visible tbody tr[data-page]").first.bounding_box()["y"] < 844 / 2
    page.get_by_text("Filter and columns").locator("visible=true").click()
    page.get_by_label("Columns").locator("visible=true").select_option("overview")
    assert "columns=overview" in page.evaluate("location.hash")
    assert page.locator("th[aria-sort]:visible").count() == 1
    scroll = page.locator(".board:visible .scroll")
    scroll.evaluate("box => { box.scrollLeft = 200 }")
    first = page.locator(".board:visible tbody tr[data-page] th").first.bounding_box()
    assert first["x"] == pytest.approx(scroll.bounding_box()["x"], abs=2)
    for state in ("", "#model=raft", "#model=dis"):
        page.evaluate("state => { location.hash = state }", state)
        page.locator("html.one-model" if state else "html:not(.one-model)").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") == 390


def test_words_and_legends_are_not_cut_off_on_a_phone(opened):
    page = opened("report", width=390, height=844)
    assert page.locator("article:visible th[scope=row]").evaluate_all(_BROKEN) == []
    boxes = [key.bounding_box() for key in page.locator(".key:visible li").all()]
    assert boxes
    assert all(box["x"] + box["width"] <= 390 for box in boxes)


def _printed(model: str, corruption: str) -> list[str]:
    """CRE, RCRE and EPE in each setting, as in the paper's tables."""
    rows = published_frame().filter(benchmark="kitti-fc", model=model, condition=corruption)
    return [
        f"{row['value']:.2f}" for metric in ("cre", "rcre", "epe") for row in rows.filter(measure=metric).to_dicts()
    ]


def test_page_of_a_model_opens_at_its_top_and_returns(opened):
    page = opened("leaderboard", "#benchmark=KITTI-FC&search=csf")
    page.evaluate("scrollTo({ top: 1200, behavior: 'instant' })")
    page.locator(".board:visible tbody a:visible").first.evaluate("link => link.click()")
    assert page.locator("h2:focus").inner_text() == "CSFlow"
    assert page.evaluate("scrollY") == 0
    assert page.locator(".board:visible").count() == 0
    assert page.title().startswith("CSFlow – ")
    assert page.locator("article:visible").count() == 1
    cells = page.locator("article:visible .heat").first.locator("tbody tr").first.locator("th, td").all_inner_texts()
    assert cells == ["JPEG compression", *_printed("CSFlow", "jpeg_compression")]
    assert page.locator("svg.chart:visible .mark.on").count() >= 2
    page.go_back()
    page.locator(".board:visible").wait_for()
    assert _shown(page) == "2 of 29 rows"
    assert page.evaluate("document.activeElement.textContent") == "CSFlow"
    page.go_forward()
    page.get_by_role("link", name="← Leaderboard").locator("visible=true").click()
    page.locator(".board:visible").wait_for()
    assert page.locator("article:visible").count() == 0


def test_site_works_by_keyboard_only(opened):
    """The skip link, a chip, a sort button, a row's link, the back link and a figure's marks work without a pointer."""
    page = opened("leaderboard", "#benchmark=KITTI-FC")
    keys = page.keyboard
    keys.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    keys.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    page.locator("input[name^=setting]:checked:visible").focus()
    keys.press("ArrowRight")
    assert _shown(page) == "2 of 29 rows"
    keys.press("ArrowLeft")
    page.locator(".board:visible thead button").nth(2).focus()
    keys.press("Space")
    assert page.locator("th[aria-sort]:visible").inner_text().startswith("Clean EPE")
    for _ in range(40):
        keys.press("Tab")
        if page.evaluate("document.activeElement.matches('.board tbody a')"):
            break
    name = page.evaluate("document.activeElement.textContent")
    keys.press("Enter")
    assert page.locator("h2:focus").inner_text() == name
    keys.press("Shift+Tab")
    keys.press("Enter")
    page.locator("html:not(.one-model)").wait_for()
    page.locator("svg.chart:visible .mark").first.focus()
    first = page.locator("#tip").inner_text()
    keys.press("ArrowRight")
    assert page.locator("#tip").inner_text() != first
    assert page.evaluate("document.activeElement.getAttribute('aria-label')") == page.locator("#tip").inner_text()
    page_of_mark = page.evaluate("document.activeElement.dataset.page")
    assert page.locator(f"tr.on[data-page='{page_of_mark}']").count() >= 1
    keys.press("Enter")
    page.locator("html.one-model").wait_for()
    assert page_of_mark in page.url


def test_pointing_at_a_mark_names_it(opened):
    """The tooltip at the centre of a bubble shows the bubble's label, although a dot is drawn on top of it."""
    page = opened("leaderboard", reduced_motion="reduce")
    _kitti(page)
    mark = page.locator("svg.chart .mark[data-label^='RAFT (ID): clean EPE 1.81 px, CRE 6.70 px']")
    mark.scroll_into_view_if_needed()
    mark.hover(force=True)
    assert page.locator("#tip").inner_text() == mark.get_attribute("data-label")
    page.mouse.move(1, 1)
    assert not page.locator("#tip").is_visible()


def test_slider_moves_over_the_severities_that_were_run(opened):
    """Severities 3 and 4 were not run."""
    page = opened("report")
    slider = page.locator("#slider-severity")
    shown = page.locator(".slider [data-corruption]:visible img")
    assert shown.get_attribute("alt") == "Contrast at severity 2"
    pictures = set()
    for key, severity in (("Home", 1), ("End", 5)):
        slider.focus()
        page.keyboard.press(key)
        assert shown.get_attribute("alt") == f"Contrast at severity {severity}"
        pictures.add(shown.get_attribute("src"))
    assert len(pictures) == 2
    page.keyboard.press("ArrowLeft")
    assert page.locator(".slider .absent:visible").count() == 1
    page.locator("#slider-corruption").select_option(label="Impulse noise")
    assert shown.get_attribute("alt") == "Impulse noise at severity 5"
    assert shown.evaluate("image => image.naturalWidth > 0")


def test_the_report_shows_its_run_first(opened):
    page = opened("report")
    assert page.locator("article:visible h2").inner_text() == "DIS"
    assert page.locator("article:visible .panel img").count() == 16
    _kitti(page)
    assert _shown(page) == "29 of 29 rows"
    cell = page.locator(".heat td a").first
    where = cell.get_attribute("title").partition(":")[0]
    cell.click()
    assert where in page.locator(".panel:focus > figcaption").inner_text()
    assert page.url.endswith(("#model=dis&panel=0", "#model=dis&panel=1"))
    drawings = page.locator("[data-scale]")
    for apart in (False, True):
        page.get_by_role("checkbox", name="Each panel with its own scale").set_checked(apart)
        assert [drawings.nth(index).is_visible() for index in range(2)] == [not apart, apart]


def test_the_theme_can_be_chosen(opened):
    page = opened("report", color_scheme="light")
    background = "getComputedStyle(document.body).backgroundColor"
    seen = [page.evaluate(background)]
    button = page.get_by_role("button", name="Theme")
    for _ in range(2):
        button.click()
        seen.append(page.evaluate(background))
    page.reload()
    assert [seen[0] == seen[1], seen[1] == seen[2], page.evaluate(background) == seen[2]] == [True, False, True]
    assert button.inner_text() == "Theme: dark"


def test_a_hostile_name_stays_text(opened):
    page = opened("hostile")
    row = page.locator(".board:visible tbody a:visible", has_text="onerror")
    assert row.inner_text() == HOSTILE
    mark = page.locator("svg.chart .mark[data-label^='<img']").first
    mark.scroll_into_view_if_needed()
    mark.focus()
    assert page.locator("#tip").inner_text().startswith(HOSTILE)
    row.click()
    assert page.locator("article:visible h2").inner_text() == HOSTILE
    assert page.title().startswith(HOSTILE)
    assert page.locator("img").count() == 0
    page.go_back()
    page.set_viewport_size({"width": 360, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") == 360, "a long word wraps everywhere"


def test_downloads_contain_the_numbers(opened, tmp_path):
    page = opened("leaderboard")
    path = tmp_path / "got"
    frames = []
    for name, read in (("Download CSV", pl.read_csv), ("Download JSON", pl.read_json)):
        with page.expect_download() as wait:
            page.get_by_role("button", name=name).click()
        wait.value.save_as(path)
        frames.append(read(path).filter(pl.col("sample_set") == "paper", pl.col("metric") != "crer"))
    published = published_frame().rename({"measure": "metric", "condition": "corruption"})
    published = published.filter(pl.col("metric").is_in(["epe", "cre", "rcre"]))
    for frame in frames:
        assert frame.height == published.height
        joined = frame.join(published, on=["benchmark", "setting", "model", "metric", "corruption"], suffix="_paper")
        assert joined.height == frame.height
        assert (joined["value"] - joined["value_paper"]).abs().max() == 0


def test_printed_page_has_every_row_and_no_control(opened):
    page = opened("leaderboard", "#benchmark=KITTI-FC&search=csf", color_scheme="dark")
    page.emulate_media(media="print")
    assert page.locator(".board:visible tbody tr[data-page]:visible").count() == 29
    assert page.locator(".controls:visible, #chooser:visible").count() == 0
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_without_scripts_the_page_says_where_the_numbers_are(browser, pages):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(pages["leaderboard"].as_uri())
    assert "results.csv" in page.locator("noscript .warn").inner_text()
    assert page.locator("svg.chart").count() >= 4
    assert page.locator(".audit tbody tr").count() == 119
    assert page.locator(".controls:visible, #chooser:visible").count() == 0
    context.close()


_VIEWS = (
    ("report", ""),  # the page of a run
    ("leaderboard", ""),
    ("leaderboard", "#benchmark=KITTI-FC&columns=weather&metric=cre"),
    ("leaderboard", "#model=raft"),
)
_FEWER = """for (const row of document.querySelectorAll(
    "tbody tr:nth-child(n + 3):not(:nth-last-child(-n + 2))")) row.remove();
for (const part of document.querySelectorAll("article, section, figure, .board"))
    if (!part.checkVisibility()) part.remove()"""


@pytest.mark.parametrize(("name", "state"), _VIEWS)
def test_pages_have_no_serious_accessibility_violation(visit, pages, serious_violations, name, state):
    """What the view hides and all but the first and last two rows of a table are removed: axe reads every element."""
    page = visit().page
    page.goto(pages[name].as_uri() + state)
    page.evaluate(_FEWER)
    for summary in page.locator("details > summary:visible").all():
        summary.click()
    assert serious_violations(page) == []
    page.emulate_media(color_scheme="dark")
    assert serious_violations(page, colours_alone=True) == []


@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_first_screen_has_the_frame_both_flows_the_error_and_their_keys(visit, pages, width, scheme):
    page = visit(width=width, height=900, color_scheme=scheme).page
    page.goto(pages["report"].as_uri())
    boxes = [image.bounding_box() for image in page.locator(".strip img:visible").all()]
    assert len(boxes) == 4 + 2
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= width and box["y"] + box["height"] < 900 for box in boxes)
    assert min(box["width"] for box in boxes[:4]) > 150
    page.get_by_role("link", name="Worst sample").click()
    tiles = [image.bounding_box() for image in page.locator(".panel:focus img").all()]
    assert all(box["x"] + box["width"] <= width for box in tiles)

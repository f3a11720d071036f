"""Fixtures for a real browser: Debian's Chromium, driven by Playwright, with its requests and console recorded."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pytest
import skimage

from robustflow.api import evaluate
from robustflow.report.site import render_site, whole_content
from robustflow.stats.results_file import parse_results
from tests.made_rows import change_manifest, made_run

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Without these, Chromium requests updates and a variations seed at startup.
_QUIET = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@dataclass
class Visit:
    """A page, its requests and its console messages."""

    page: Page
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.listeners = {
            "request": lambda request: self.requests.append(request.url),
            "pageerror": lambda error: self.complaints.append(str(error)),
            "console": lambda line: self.complaints.append(line.text) if line.type in ("error", "warning") else None,
        }

    def outside(self, *allowed: str) -> list[str]:
        """Requests to anything outside the file: those whose URL does not start with `file:`, `data:`, `blob:` or
        one of the prefixes `allowed`.
        """
        return [url for url in self.requests if not url.startswith(("file:", "data:", "blob:", *allowed))]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One Chromium instance for all tests in a process; skips with a reason if Playwright or Chromium is missing."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (dev extra)")
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("Chromium is not installed: apt-get install chromium")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=list(_QUIET))
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def tabs() -> dict[bool, Page]:
    """The pages that tests share: a new one costs Chromium as much as most tests. The key is `bypass_csp`."""
    return {}


@pytest.fixture
def visit(browser: Browser, tabs: dict[bool, Page]) -> Iterator[Callable[..., Visit]]:
    """Make a page with `visit(width=390, height=844, color_scheme="dark")`, without any state of the tests before."""
    listening = []

    def make(width: int = 1440, height: int = 900, bypass_csp: bool = False, **media: str) -> Visit:
        if bypass_csp not in tabs:
            tabs[bypass_csp] = browser.new_context(bypass_csp=bypass_csp).new_page()
        page = tabs[bypass_csp]
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(**{"media": "screen", "color_scheme": "light", "reduced_motion": "no-preference", **media})
        made = Visit(page)
        for event, listener in made.listeners.items():
            page.on(event, listener)
        listening.append(made)
        return made

    yield make
    for made in listening:
        for event, listener in made.listeners.items():
            made.page.remove_listener(event, listener)
        made.page.evaluate("localStorage.clear()")
        made.page.context.clear_cookies()
        made.page.goto("about:blank")


@pytest.fixture
def serious_violations() -> Callable[..., list[tuple[str, str]]]:
    """Return axe-core's serious and critical findings on a page: of all its rules, or only of the colours."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed (dev extra)"
    )

    def run(page: Page, colours_alone: bool = False) -> list[tuple[str, str]]:
        rules = {"runOnly": ["color-contrast", "link-in-text-block"]} if colours_alone else {}
        response = axe.Axe().run(page, options={"resultTypes": ["violations"], **rules}).response
        assert len(response["passes"]) > (0 if colours_alone else 15)
        return [
            (violation["id"], violation["nodes"][0]["html"][:200])
            for violation in response["violations"]
            if violation["impact"] in ("serious", "critical")
        ]

    return run


HOSTILE = "<img src=x onerror=alert(1)>"
_CELLS = "setting,model,metric,corruption,value\n" + "".join(
    f"OOD,{name},{metric},{corruption},{value}\n"
    for name in ("A", "B")
    for metric, corruption, value in (("epe", "clean", 2), ("epe", "average", 5), ("epe", "fog", 4), ("cre", "fog", 2))
)


@pytest.fixture(scope="session")
def pages(tmp_path_factory, real_pictures, small_demo) -> dict[str, Path]:
    """report.html of a run with pictures, the published leaderboard, and a leaderboard with hostile names."""
    folder = tmp_path_factory.mktemp("pages")
    options = {"corruptions": ["contrast", "impulse_noise"], "severities": [1, 2, 5]}
    with real_pictures(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(skimage, "__file__", small_demo)
        run = evaluate("dis", "demo", output=folder / "run", examples=True, **options)
    name = pl.when(model="A").then(pl.lit(HOSTILE)).otherwise(pl.lit("x" * 200))
    hostile = parse_results(_CELLS, "made.csv", "file").with_columns(model=name, note=pl.lit(HOSTILE))
    paths = {"report": run.path / "report.html"}
    twin = made_run(run, run.rows, "Twin")
    change_manifest(twin, identity_digest=run.manifest.identity_digest)
    whole = {"leaderboard": whole_content([run, twin])}
    whole["hostile"] = whole_content([], [(HOSTILE, hostile)], published=False)
    for name, content in whole.items():
        paths[name] = folder / f"{name}.html"
        paths[name].write_text(render_site(content), encoding="utf-8")
    return paths

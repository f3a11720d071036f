"""The documentation site builds without warnings, loads nothing from other sites, and is readable on any screen."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from robustflow.corruptions.registry import SHIPPED

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "index",
    "corruptions/index",
    "corruptions/snow",
    "reference/python",
    "reference/cli/run",
    "reference/catalogue",
    "tutorials/reading-a-run",
    "design/metrics",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("mkdocstrings") is None, reason="needs the docs extra"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The documentation site, built as in CI."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900)
    assert built.returncode == 0, built.stderr[-3000:]
    return folder


def test_each_corruption_has_a_page_with_its_images(site):
    for name in SHIPPED:
        page = (site / "corruptions" / f"{name}.html").read_text()
        pictures = re.findall(r'<img src="(images/[^"]+)"', page)
        assert len(pictures) == 12, name
        assert all((site / "corruptions" / picture).is_file() for picture in pictures)
        assert "<math" in page


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_documentation_has_no_serious_violation_or_external_file(visit, site, serious_violations, name, scheme):
    seen = visit(color_scheme=scheme)
    seen.page.goto((site / f"{name}.html").as_uri())
    assert serious_violations(seen.page) == []
    assert seen.outside() == []


@pytest.mark.browser
def test_the_home_page_shows_a_picture(visit, site):
    page = visit().page
    page.goto((site / "index.html").as_uri())
    picture = page.locator("article img").first
    assert picture.evaluate("image => image.complete && image.naturalWidth > 600")
    assert picture.bounding_box()["y"] < 900
    assert "fog" in picture.get_attribute("alt") or "corruptions" in picture.get_attribute("alt")


@pytest.mark.browser
def test_the_tables_of_the_catalogue_fit_their_page(visit, site):
    page = visit(width=1440).page
    page.goto((site / "reference" / "catalogue.html").as_uri())
    beyond = page.locator(".md-typeset__scrollwrap").evaluate_all(
        "all => all.map(one => one.scrollWidth - one.clientWidth)"
    )
    assert len(beyond) == 5
    assert max(beyond) <= 0


@pytest.mark.browser
@pytest.mark.parametrize("name", PAGES)
def test_documentation_page_fits_a_phone(visit, site, name):
    page = visit(width=390, height=844).page
    page.goto((site / f"{name}.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")

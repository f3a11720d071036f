"""axe-core finds no serious or critical problem in any view of the pages, light or dark."""

import pytest

pytestmark = pytest.mark.browser

_VIEWS = (
    ("report", ""),
    ("leaderboard", ""),
    ("leaderboard", "#benchmark=KITTI-FC&columns=weather&metric=cre"),
    ("leaderboard", "#model=raft"),
    ("leaderboard", "#model=dis"),
)


_FEWER_ROWS = """for (const row of document.querySelectorAll(
    "tbody tr:nth-child(n + 3):not(:nth-last-child(-n + 2))")) row.remove()"""


@pytest.mark.parametrize(("name", "state"), _VIEWS)
def test_no_serious_violation(visit, pages, name, state):
    """The first and last two rows of each table are enough: axe takes a millisecond for each cell."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed (dev extra)"
    )
    page = visit().page
    page.goto(pages[name].as_uri() + state)
    page.evaluate(_FEWER_ROWS)
    for summary in page.locator("details > summary:visible").all():
        summary.click()
    for scheme, rules in (("light", []), ("dark", ["color-contrast", "link-in-text-block"])):
        page.emulate_media(color_scheme=scheme)
        found = axe.Axe().run(page, options={"resultTypes": ["violations"], **({"runOnly": rules} if rules else {})})
        serious = [
            (violation["id"], violation["nodes"][0]["html"][:200])
            for violation in found.response["violations"]
            if violation["impact"] in ("serious", "critical")
        ]
        assert serious == [], scheme
        assert len(found.response["passes"]) > (0 if rules else 15)

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


@pytest.mark.parametrize(("name", "state"), _VIEWS)
def test_no_serious_violation(visit, pages, name, state):
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed (dev extra)"
    )
    page = visit().page
    page.goto(pages[name].as_uri() + state)
    for summary in page.locator("details > summary:visible").all():
        summary.click()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found = axe.Axe().run(page).response
        serious = [
            (violation["id"], violation["nodes"][0]["html"][:200])
            for violation in found["violations"]
            if violation["impact"] in ("serious", "critical")
        ]
        assert serious == [], scheme
        assert len(found["passes"]) > 15
